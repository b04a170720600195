// Flash: a host directory, mirrored at every close, removal and rename, as a board stores closed files.
import fs from "node:fs";
import path from "node:path";

export const FLASH = "/flash";

/** Copies the host folder `config.flash` to FLASH, and keeps both synchronised. */
export function mirrorFlash(FS, config) {
  function load(from, to) {
    for (const entry of fs.readdirSync(from, { withFileTypes: true })) {
      const host = path.join(from, entry.name), here = `${to}/${entry.name}`;
      if (entry.isDirectory()) {
        FS.mkdir(here);
        load(host, here);
      } else FS.writeFile(here, fs.readFileSync(host));
    }
  }

  FS.mkdir(FLASH);
  load(config.flash, FLASH);

  const onHost = (p) => (p.startsWith(`${FLASH}/`) ? path.join(config.flash, p.slice(FLASH.length)) : null);
  const absolute = (p) => (p.startsWith("/") ? p : `${FS.cwd()}/${p}`.replace("//", "/"));
  const { close, unlink, mkdir, rmdir, rename } = FS;

  // A change is permanent once on the host; it is also a line of the journal, if there is one.
  function changed(what, p, more) {
    if (config.flash_journal) fs.appendFileSync(config.flash_journal, `${JSON.stringify({ what, path: p, ...more })}\n`);
  }

  FS.close = (stream) => {
    const host = stream.path && (stream.flags & 3) !== 0 ? onHost(stream.path) : null;
    const node = stream.node;
    close(stream);
    // An empty file has no typed array.
    if (host === null || !FS.isFile(node.mode)) return;
    const bytes = Buffer.from(node.usedBytes ? node.contents.subarray(0, node.usedBytes) : "");
    fs.writeFileSync(host, bytes);
    changed("write", stream.path.slice(FLASH.length), { base64: bytes.toString("base64") });
  };
  FS.unlink = (p) => {
    unlink(p);
    const host = onHost(absolute(p));
    if (host === null) return;
    fs.unlinkSync(host);
    changed("unlink", absolute(p).slice(FLASH.length));
  };
  FS.mkdir = (p, m) => {
    const made = mkdir(p, m);
    const host = onHost(absolute(p));
    if (host === null) return made;
    fs.mkdirSync(host);
    changed("mkdir", absolute(p).slice(FLASH.length));
    return made;
  };
  FS.rmdir = (p) => {
    rmdir(p);
    const host = onHost(absolute(p));
    if (host === null) return;
    fs.rmdirSync(host);
    changed("rmdir", absolute(p).slice(FLASH.length));
  };
  FS.rename = (a, b) => {
    rename(a, b);
    const [from, to] = [onHost(absolute(a)), onHost(absolute(b))];
    if (from === null || to === null) return;
    fs.renameSync(from, to);
    changed("rename", absolute(a).slice(FLASH.length), { to: absolute(b).slice(FLASH.length) });
  };
}

/** Mounts the modules of the board at /rom; an installed package also has their bytecode, in a folder. */
export function layRom(FS, rom) {
  FS.mkdir("/rom");
  for (const name of fs.readdirSync(rom).filter((file) => file.endsWith(".py"))) {
    FS.writeFile(`/rom/${name}`, fs.readFileSync(path.join(rom, name)));
  }
}
