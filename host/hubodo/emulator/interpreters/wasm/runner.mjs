// The interpreter of virtual nodes: MicroPython (WebAssembly) whose world is the board behind two pipes.
// It runs one board after the other: the second finds all of MicroPython compiled.
import v8 from "node:v8";
import "./table.mjs";
import { die, Over, Pipe } from "../pipe.mjs";
import { live } from "./life.mjs";

// What MicroPython's code would gain from the second compiler is less than that takes, but for rides of minutes.
v8.setFlagsFromString("--liftoff-only");

const { micropython, pipes } = JSON.parse(process.argv[2]);
const pipe = new Pipe(pipes);
const { loadMicroPython } = await import(micropython);

const instantiate = WebAssembly.instantiate;
let compiled = null, adapt = null; // how the next instance's imports are changed

WebAssembly.instantiate = async (bytes, imports) => {
  compiled ??= await WebAssembly.compile(bytes);
  adapt(imports);
  return { module: compiled, instance: await instantiate(compiled, imports) };
};

for (;;) {
  const config = pipe.start(); // what the board's processor.py tells
  try {
    await live(config, pipe, (adapted, options) => {
      adapt = adapted;
      return loadMicroPython(options);
    });
  } catch (error) {
    if (!(error instanceof Over)) die(error);
  }
}
