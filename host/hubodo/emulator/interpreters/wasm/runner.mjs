// Interpreter of virtual nodes: MicroPython (WebAssembly), connected to its board by two pipes.
// It serves one board after another; MicroPython is compiled only once.
import v8 from "node:v8";
import "./table.mjs";
import { die, Over, Pipe } from "../pipe.mjs";
import { live } from "./life.mjs";

// The optimising compiler pays off only for rides of minutes.
v8.setFlagsFromString("--liftoff-only");

const { micropython, pipes } = JSON.parse(process.argv[2]);
const pipe = new Pipe(pipes);
const { loadMicroPython } = await import(micropython);

const instantiate = WebAssembly.instantiate;
let compiled = null, adapt = null; // changes of the imports of the next instance

WebAssembly.instantiate = async (bytes, imports) => {
  compiled ??= await WebAssembly.compile(bytes);
  adapt(imports);
  return { module: compiled, instance: await instantiate(compiled, imports) };
};

for (;;) {
  const config = pipe.start(); // settings from processor.py
  try {
    await live(config, pipe, (adapted, options) => {
      adapt = adapted;
      return loadMicroPython(options);
    });
  } catch (error) {
    if (!(error instanceof Over)) die(error);
  }
}
