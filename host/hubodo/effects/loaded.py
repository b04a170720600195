"""Load user-defined effects from Python files and from installed packages."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable, Iterator
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType

import numpy as np

from hubodo.effects import BY_NAME, EFFECTS, Effect, SensorChain
from hubodo.effects.field import FIELD_EFFECTS
from hubodo.effects.sensor_chain import REFERENCE_VOLTS
from hubodo.errors import ConfigError

ENTRY_POINT_GROUP = "hubodo.effects"
"""Group of the entry points under which installed packages offer effects."""
_EFFECT_NAME_PATTERN = re.compile(r"[a-z][a-z0-9_]*")
_STAGES = (
    "true_time",
    "adjust_geometry",
    "rotate_into_node",
    "low_pass_rate",
    "add_scale_errors",
    "add_offsets",
    "add_random_walk",
    "add_outliers",
    "clip_readings",
    "quantize_readings",
    "repeat_samples",
)
_BUILT_IN_NAMES = frozenset(effect.name for effect in (*EFFECTS, *FIELD_EFFECTS))


def use_effects(files: Iterable[Path] = (), field: bool = False) -> None:
    """Add the effects of installed packages and of Python files to `BY_NAME`, replacing namesakes.

    Parameters
    ----------
    files : Python files; each is executed.
    field : True to add the effects of `effects/field.py` too.

    Raises
    ------
    ConfigError
        If a file cannot be executed or defines no effect, or if an effect is incomplete.
    """
    if field:
        BY_NAME.update({effect.name: effect for effect in FIELD_EFFECTS})
    for entry in _installed_entries(tuple(sys.path)):
        try:
            effects = list(_effects_of_entry(entry.load()))
        except (ImportError, AttributeError) as error:
            raise ConfigError(
                f"{ENTRY_POINT_GROUP} of {entry.value}: {error}; repair or remove that package"
            ) from None
        _add(effects, f"{ENTRY_POINT_GROUP} of {entry.value}")
    for path in files:
        _add(read_effects(path), str(path))


def read_effects(path: Path) -> list[type[Effect]]:
    """Execute a Python file and return the effects that it defines. Raise ConfigError as `use_effects`."""
    if str(path) in BY_NAME:
        raise ConfigError(
            f"{path}: is an effect, not a file of effects; --accept {path} adds it to the model"
        )
    if path.suffix != ".py":
        raise ConfigError(f"{path}: name a Python file with effects, such as hubodo gap --scaffold writes")
    try:
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{path}: cannot be read ({reason}); check the path") from None
    return run_effects(text, path)


def run_effects(text: str, path: Path) -> list[type[Effect]]:
    """Return the effects that the text of a Python file defines. Raise ConfigError as `use_effects`."""
    module = ModuleType(f"hubodo_effects_{path.stem}")
    module.__file__ = str(path.absolute())
    # The dataclass decorator looks up the module by name.
    sys.modules[module.__name__] = module
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except Exception as error:  # noqa: BLE001 - code of a user may raise anything
        raise ConfigError(f"{path}: cannot be run: {type(error).__name__}: {error}") from None
    effects = list(_effects_of_module(module))
    for effect in effects:
        _check(effect, str(path))
    if not effects:
        raise ConfigError(f"{path}: defines no effect; derive a class from hubodo.effects.Effect")
    return effects


def name_problem(name: str) -> str:
    """Return the reason why a new effect cannot have this name; "" if it can."""
    if not _EFFECT_NAME_PATTERN.fullmatch(name):
        return "write a name of lower-case letters, digits and _, such as bent_axle"
    return "an effect of that name exists already" if name in _BUILT_IN_NAMES else ""


@lru_cache(maxsize=1)
def _installed_entries(path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points of the packages installed on `sys.path`; a search takes ten milliseconds."""
    return tuple(entry_points(group=ENTRY_POINT_GROUP))


def _effects_of_entry(loaded: object) -> Iterator[type[Effect]]:
    """Yield the effects of an entry point: a class, several classes, or a module of them."""
    if isinstance(loaded, ModuleType):
        yield from _effects_of_module(loaded)
    elif isinstance(loaded, type) and issubclass(loaded, Effect):
        yield loaded
    elif isinstance(loaded, Iterable):
        yield from (it for it in loaded if isinstance(it, type) and issubclass(it, Effect))


def _effects_of_module(module: ModuleType) -> Iterator[type[Effect]]:
    """Yield the effects that a module defines itself."""
    for value in vars(module).values():
        if isinstance(value, type) and issubclass(value, Effect) and value.__module__ == module.__name__:
            yield value


def _add(effects: Iterable[type[Effect]], where: str) -> None:
    """Check effects and add them to `BY_NAME`; where: their source, for errors."""
    for effect in effects:
        _check(effect, where)
        BY_NAME[effect.name] = effect


def _check(effect: type[Effect], where: str) -> None:
    """Raise ConfigError if an effect lacks name, meaning, parameters or a stage, or if a stage fails."""
    missing = [it for it in ("name", "meaning") if not isinstance(getattr(effect, it, None), str)]
    if missing or inspect.isabstract(effect):
        raise ConfigError(f"{where}: {effect.__name__}: {' and '.join(missing)} missing")
    problem = name_problem(effect.name)
    if problem:
        raise ConfigError(f"{where}: {effect.__name__}: name = {effect.name!r}: {problem}")
    try:
        guess = effect.initial_guesses()[0]
        if not effect.parameters() or len(guess.coordinates()) != len(effect.coordinate_scales()):
            raise ValueError("declare each field as parameter(unit, scale)")
        if all(getattr(effect, stage) is getattr(Effect, stage) for stage in _STAGES):
            raise ValueError(f"override one of {', '.join(_STAGES)}")
        _run_stages(guess)
    except Exception as error:  # noqa: BLE001 - code of a user may raise anything
        raise ConfigError(f"{where}: {effect.__name__}: {type(error).__name__}: {error}") from None


def _run_stages(effect: Effect) -> None:
    """Run each stage that a fit uses once, on a second of standstill, so that its errors are reported now."""
    t = np.linspace(0.0, 1.0, 20)
    zero = np.zeros_like(t)
    chain = SensorChain(t, zero + 25.0, *np.zeros((5, 3, len(t))))
    chain.angle, chain.spin, chain.opposite_spin = zero, zero, zero
    chain.speed, chain.acceleration, chain.heading = zero, zero, zero
    chain.yaw_rate, chain.yaw_acceleration, chain.supply = zero, zero, zero + REFERENCE_VOLTS
    if effect.true_time(t).shape != t.shape:
        raise ValueError("true_time must return as many times as it is given")
    for stage in (
        effect.rotate_into_node,
        effect.low_pass_rate,
        effect.add_scale_errors,
        effect.add_offsets,
        effect.clip_readings,
    ):
        stage(chain)
