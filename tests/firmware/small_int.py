"""An int that refuses what MicroPython would have to put on the heap."""

LIMIT = 1 << 30


class NotSmall(AssertionError):
    """A result beyond +-2^30."""


class SmallInt(int):
    """Every result of arithmetic is a SmallInt again, or NotSmall is raised; `widest` is the largest seen."""

    widest = 0

    @classmethod
    def of(cls, value):
        if value is NotImplemented:
            return value
        if not -LIMIT <= value < LIMIT:
            raise NotSmall(f"{value} needs more than 31 bits")
        if value > cls.widest:
            cls.widest = value
        return int.__new__(cls, value)


def _checked(name):
    plain, of = getattr(int, name), SmallInt.of

    def operation(self, *others):
        return of(plain(self, *others))

    return operation


for _name in ("add", "sub", "mul", "floordiv", "mod", "lshift", "rshift", "and", "or", "xor"):
    for _form in (f"__{_name}__", f"__r{_name}__"):
        setattr(SmallInt, _form, _checked(_form))
for _name in ("__neg__", "__abs__", "__invert__", "__pow__"):
    setattr(SmallInt, _name, _checked(_name))
