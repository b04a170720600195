"""Effects from user files and installed packages; errors are one line."""

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from example_effect import HUM
from hubodo.effects import BY_NAME, EFFECTS, loaded
from hubodo.effects.loaded import name_problem, read_effects, use_effects
from hubodo.errors import ConfigError

pytestmark = pytest.mark.usefixtures("restore_effects_after_each")


def written(tmp_path, text, name="hum.py"):
    path = tmp_path / name
    path.write_text(text, "utf-8")
    return path


def test_a_file_adds_its_effects_after_those_of_the_list(tmp_path):
    use_effects([written(tmp_path, HUM)])
    assert list(BY_NAME)[:-1] == [effect.name for effect in EFFECTS]
    assert BY_NAME["hum"](0.5).k == 0.5


def test_a_changed_file_replaces_its_effects(tmp_path):
    use_effects([written(tmp_path, HUM)])
    use_effects([written(tmp_path, HUM.replace("k more", "k now"))])
    assert BY_NAME["hum"].__doc__ == "gz reads k now."
    assert len(BY_NAME) == len(EFFECTS) + 1


def test_an_installed_package_offers_effects(tmp_path, monkeypatch):
    written(tmp_path, HUM, "offered_hum.py")
    monkeypatch.syspath_prepend(str(tmp_path))
    entry = EntryPoint("hum", "offered_hum", loaded.ENTRY_POINT_GROUP)
    monkeypatch.setattr(
        loaded, "entry_points", lambda group: [entry] if group == loaded.ENTRY_POINT_GROUP else []
    )
    use_effects()
    assert "hum" in BY_NAME


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            'name: ClassVar[str] = "hum"',
            'name: ClassVar[str] = "gyro_bias"',
            "an effect of that name exists",
        ),
        ('name: ClassVar[str] = "hum"', 'name: ClassVar[str] = "Hum!"', "lower-case letters"),
        ('    meaning: ClassVar[str] = "the gyro hums"\n', "", "meaning missing"),
        ("chain.gyro[2]", "chain.gyroscope[2]", "gyroscope"),
        ("import dataclass", "import dataclas", "cannot be run: ImportError"),
        ("class Hum(Effect)", "class Hum(Effect", "SyntaxError"),
        ("(Effect):", "():", "defines no effect"),
        ('    k: float = parameter("rad/s", 0.01)\n', "", "parameter(unit, scale)"),
        ("def add_offsets(", "def offset(", "override one of true_time"),
    ],
)
def test_an_invalid_file_is_refused_with_the_reason(tmp_path, old, new, says):
    assert old in HUM
    path = written(tmp_path, HUM.replace(old, new))
    with pytest.raises(ConfigError, match=str(path)) as caught:
        use_effects([path])
    assert says in str(caught.value)
    assert "hum" not in BY_NAME


def test_a_missing_or_non_python_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_effects(tmp_path / "none.py")
    with pytest.raises(ConfigError, match="name a Python file"):
        read_effects(written(tmp_path, HUM, "hum.txt"))
    with pytest.raises(ConfigError, match="--accept wheel_camber adds it"):
        read_effects(Path("wheel_camber"))  # `--effect NAME` is an abbreviation of `--effects FILE.py`


def test_names_of_new_effects_are_checked():
    assert name_problem("bent_axle") == ""
    assert name_problem("Bent Axle") and name_problem("gyro_bias") and name_problem("")
