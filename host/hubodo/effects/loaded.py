"""Effects from outside the package: of Python files that the user names, and of installed packages."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

import numpy as np

from hubodo.effects import BY_NAME, EFFECTS, Chain, Effect
from hubodo.effects.base import REFERENCE_VOLTS
from hubodo.effects.field import FIELD
from hubodo.errors import ConfigError

GROUP = "hubodo.effects"
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_OWN = frozenset(effect.name for effect in (*EFFECTS, *FIELD))


def use_effects(files: Iterable[Path] = (), field: bool = False) -> None:
    """Add to `BY_NAME` what installed packages offer under `hubodo.effects`, and what these files hold.

    field: and what `effects/field.py` has, whose names are as those of the list then.

    One of a name that was added before takes its place. Raises ConfigError for a file that cannot be run,
    one without an effect, and an effect that is not complete.
    """
    if field:
        BY_NAME.update({effect.name: effect for effect in FIELD})
    for entry in entry_points(group=GROUP):
        try:
            found = list(_offered(entry.load()))
        except (ImportError, AttributeError) as error:
            raise ConfigError(f"{GROUP} of {entry.value}: {error}; mend or remove that package") from None
        _add(found, f"{GROUP} of {entry.value}")
    for path in files:
        _add(read_effects(path), str(path))


def read_effects(path: Path) -> list[type[Effect]]:
    """The effects that a Python file defines; it is run for that. Raises ConfigError as `use_effects`."""
    if path.suffix != ".py":
        raise ConfigError(f"{path}: name a Python file with effects, such as hubodo gap --scaffold writes")
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    return run_effects(text, path)


def run_effects(text: str, path: Path) -> list[type[Effect]]:
    """The effects that the text of a file defines. Raises ConfigError as `use_effects`."""
    module = ModuleType(f"hubodo_effects_{path.stem}")
    module.__file__ = str(path.absolute())
    # A dataclass looks up its module by name.
    sys.modules[module.__name__] = module
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except Exception as error:  # noqa: BLE001 - whatever a foreign file does wrong, it is that file's
        raise ConfigError(f"{path}: cannot be run: {type(error).__name__}: {error}") from None
    found = list(_of_module(module))
    for effect in found:
        _check(effect, str(path))
    if not found:
        raise ConfigError(f"{path}: defines no effect; a class of it derives from hubodo.effects.Effect")
    return found


def free_name(name: str) -> str:
    """Why no new effect can be called so, in words; "" where one can."""
    if not _NAME.fullmatch(name):
        return "write a name of small letters, digits and _, such as bent_axle"
    return "there is an effect of that name already" if name in _OWN else ""


def _offered(loaded: object) -> Iterator[type[Effect]]:
    """Of an entry point: an effect, several, or a module of them."""
    if isinstance(loaded, ModuleType):
        yield from _of_module(loaded)
    elif isinstance(loaded, type) and issubclass(loaded, Effect):
        yield loaded
    elif isinstance(loaded, Iterable):
        yield from (it for it in loaded if isinstance(it, type) and issubclass(it, Effect))


def _of_module(module: ModuleType) -> Iterator[type[Effect]]:
    for value in vars(module).values():
        if isinstance(value, type) and issubclass(value, Effect) and value.__module__ == module.__name__:
            yield value


def _add(found: Iterable[type[Effect]], where: str) -> None:
    for effect in found:
        _check(effect, where)
        BY_NAME[effect.name] = effect


def _check(effect: type[Effect], where: str) -> None:
    """Raises ConfigError for an effect without name, meaning or parameters, or whose stages do not run."""
    missing = [what for what in ("name", "meaning") if not isinstance(getattr(effect, what, None), str)]
    if missing or inspect.isabstract(effect):
        raise ConfigError(f"{where}: {effect.__name__}: {' and '.join(missing)} missing")
    says = free_name(effect.name)
    if says:
        raise ConfigError(f"{where}: {effect.__name__}: name = {effect.name!r}: {says}")
    try:
        made = effect.seeds()[0]
        if not effect.parameters() or len(made.coordinates()) != len(effect.coordinate_scales()):
            raise ValueError("give each field as parameter(unit, usual size)")
        _run(made)
    except Exception as error:  # noqa: BLE001 - as above
        raise ConfigError(f"{where}: {effect.__name__}: {type(error).__name__}: {error}") from None


def _run(effect: Effect) -> None:
    """Each stage that a fit goes through, once, on a second of nothing."""
    t = np.linspace(0.0, 1.0, 20)
    zero = np.zeros_like(t)
    chain = Chain(t, zero + 25.0, *np.zeros((5, 3, len(t))))
    chain.angle, chain.spin, chain.spin_beside = zero, zero, zero
    chain.speed, chain.acceleration, chain.heading = zero, zero, zero
    chain.yaw_rate, chain.yaw_acceleration, chain.supply = zero, zero, zero + REFERENCE_VOLTS
    if effect.true_time(t).shape != t.shape:
        raise ValueError("true_time gives another number of times than it gets")
    for stage in (effect.mount, effect.low_pass, effect.respond, effect.offset, effect.clip):
        stage(chain)
