"""An int that raises an error where MicroPython would allocate a long integer on the heap."""

LIMIT = 1 << 30


class NotSmall(AssertionError):
    """Raised for a result outside ±2^30."""


class SmallInt(int):
    """An int whose arithmetic returns SmallInt or raises NotSmall; `widest`: largest value passed to `of`."""

    widest = 0

    @classmethod
    def of(cls, value):
        """Return a SmallInt and update `widest`."""
        cls.widest = max(cls.widest, value)
        return SmallInt(value) + 0


def _checked(name):
    plain, new = getattr(int, name), int.__new__

    # A test creates millions of them: no calls except for the creation of the number.
    def operation(self, *others):
        value = plain(self, *others)
        if value is NotImplemented:
            return value
        if -LIMIT <= value < LIMIT:
            return new(SmallInt, value)
        raise NotSmall(f"{value} needs more than 31 bits")

    return operation


for _name in ("add", "sub", "mul", "floordiv", "mod", "lshift", "rshift", "and", "or", "xor"):
    for _form in (f"__{_name}__", f"__r{_name}__"):
        setattr(SmallInt, _form, _checked(_form))
for _name in ("__neg__", "__abs__", "__invert__", "__pow__"):
    setattr(SmallInt, _name, _checked(_name))
