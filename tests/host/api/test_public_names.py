"""What is public stays as it was promised: names may come, but none goes and no argument changes unmeant.

Update after names have come, or after a change that is told in CHANGELOG.md:

    PYTHONPATH=host:protocol python tests/host/api/test_public_names.py
"""

import inspect
from pathlib import Path

import hubodo

PROMISED = Path(__file__).with_name("public_names.txt")


def described():
    """A line for each public name and each public member of a public class."""
    for name in sorted(set(hubodo.__all__) - {"__version__"}):
        thing = getattr(hubodo, name)
        if inspect.isclass(thing):
            yield f"class {name}({', '.join(base.__name__ for base in thing.__bases__)})"
            yield from sorted(f"{name}.{line}" for line in members(thing))
        else:
            yield f"{name}{inspect.signature(thing)}"


def members(kind):
    for name in getattr(kind, "__dataclass_fields__", ()):
        yield name
    for name, member in vars(kind).items():
        if name.startswith("_") or name in getattr(kind, "__dataclass_fields__", ()):
            continue
        yield f"{name}{inspect.signature(member)}" if inspect.isfunction(member) else name


def test_no_public_name_is_gone_and_none_takes_other_arguments():
    assert set(PROMISED.read_text("utf-8").splitlines()) <= set(described())


if __name__ == "__main__":
    PROMISED.write_text("\n".join(described()) + "\n", "utf-8")
