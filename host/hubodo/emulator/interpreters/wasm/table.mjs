// Fast lookup of function tables, which this build of MicroPython checks at each indirect call.
const { get, set } = WebAssembly.Table.prototype;
const KNOWN = Symbol("known");

WebAssembly.Table.prototype.get = function (index) {
  const known = (this[KNOWN] ??= []);
  return (known[index] ??= get.call(this, index));
};

WebAssembly.Table.prototype.set = function (index, value) {
  if (this[KNOWN]) this[KNOWN][index] = undefined;
  set.call(this, index, value);
};
