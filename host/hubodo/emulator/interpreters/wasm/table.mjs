// The table of functions, looked up quickly: this build of MicroPython checks each call between its parts against it.
const { get, set } = WebAssembly.Table.prototype;
const known = [];

WebAssembly.Table.prototype.get = function (index) {
  return (known[index] ??= get.call(this, index));
};

WebAssembly.Table.prototype.set = function (index, value) {
  known[index] = undefined;
  set.call(this, index, value);
};
