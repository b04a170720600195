"""Public names and signatures stay as promised: names may be added, but none is removed or changed.

Update the promise after adding names, or after a change that CHANGELOG.md describes:

    PYTHONPATH=host:protocol python tests/host/api/test_public_names.py
"""

import inspect
from pathlib import Path

import hubodo

PROMISED = Path(__file__).with_name("public_names.txt")


def public_lines():
    """Yield a line for each public name and each public member of a public class."""
    for name in sorted(set(hubodo.__all__) - {"__version__"}):
        public_object = getattr(hubodo, name)
        if inspect.isclass(public_object):
            yield f"class {name}({', '.join(base.__name__ for base in public_object.__bases__)})"
            yield from sorted(f"{name}.{line}" for line in members(public_object))
        else:
            yield f"{name}{inspect.signature(public_object)}"


def members(kind):
    for name in getattr(kind, "__dataclass_fields__", ()):
        yield name
    own = [base for base in reversed(kind.__mro__) if base.__module__.startswith("hubodo.")]
    for name, member in {name: member for base in own for name, member in vars(base).items()}.items():
        if name.startswith("_") or name in getattr(kind, "__dataclass_fields__", ()):
            continue
        yield f"{name}{inspect.signature(member)}" if inspect.isfunction(member) else name


def test_no_public_name_or_signature_was_removed_or_changed():
    assert set(PROMISED.read_text("utf-8").splitlines()) <= set(public_lines())


if __name__ == "__main__":
    PROMISED.write_text("\n".join(public_lines()) + "\n", "utf-8")
