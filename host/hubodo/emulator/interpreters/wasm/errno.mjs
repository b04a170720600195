// This build reports error numbers of Emscripten; boards and mpremote use those of Linux.
const ERRNO = { 2: 13, 6: 11, 8: 9, 10: 16, 20: 17, 28: 22, 29: 5, 31: 21, 37: 36, 44: 2, 48: 12, 51: 28, 54: 20, 55: 39, 63: 1, 69: 30, 75: 18 };
export const EINTR = 27;

/** Linux error number of an Emscripten error number. */
export const linux = (number) => ERRNO[number] ?? number;

/** System calls that report Linux error numbers. */
export function withLinuxErrno(imports) {
  for (const [name, f] of Object.entries(imports.env)) {
    if (name.startsWith("__syscall_")) {
      imports.env[name] = (...args) => {
        const r = f(...args);
        return r < 0 ? -linux(-r) : r;
      };
    }
  }
  const wasi = imports.wasi_snapshot_preview1;
  for (const name of ["fd_close", "fd_sync", "fd_seek", "fd_read", "fd_write"]) {
    const f = wasi[name];
    wasi[name] = (...args) => {
      const r = f(...args);
      return r > 0 ? linux(r) : r;
    };
  }
}
