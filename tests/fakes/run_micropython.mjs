// Runs Python pieces in real MicroPython: node run_micropython.mjs JOB.json
// JOB: {"files": [[path on the board, path here], ..], "run": [source, ..], "out": path for its stdout}
// Each piece runs by itself, and garbage is collected between them, as this port only does then.
// What it leaves in /result is printed.
import fs from "node:fs";
import path from "node:path";
import "../../host/hubodo/emulator/interpreters/wasm/table.mjs";
import { loadMicroPython } from "@micropython/micropython-webassembly-pyscript/micropython.mjs";

const job = JSON.parse(fs.readFileSync(process.argv[2], "utf8"));
const printed = [];
const mp = await loadMicroPython({
  heapsize: job.heap ?? 256 * 1024,
  linebuffer: false,
  stdin: () => null,
  stdout: (bytes) => printed.push(...bytes),
});
for (const [there, here] of job.files) {
  const folder = path.posix.dirname(there);
  if (folder !== "/" && !mp.FS.analyzePath(folder).exists) mp.FS.mkdir(folder);
  mp.FS.writeFile(there, fs.readFileSync(here));
}
try {
  for (const source of job.run) mp.runPython(source);
} finally {
  fs.writeFileSync(job.out, Buffer.from(printed));
}
process.stdout.write(mp.FS.readFile("/result", { encoding: "utf8" }));
