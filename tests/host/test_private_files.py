"""Files in folders that other users can write to, and secrets that other users must not read."""

import os

import pytest

from hubodo.atomic_files import atomic_files, atomic_folder, atomic_new_file, write_atomically
from hubodo.errors import InputError
from hubodo.ingest.link.keys import KeyRing
from hubodo.web.config import WebConfig, read_token, web_site

needs_root = pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs two users")


@pytest.fixture
def shared(tmp_path):
    """Create a folder that every user can write to."""
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o777)
    return folder


def hidden_files(folder):
    return {path for path in folder.iterdir() if path.name.startswith(".")}


@pytest.mark.parametrize("write", [atomic_files, atomic_new_file])
def test_a_file_is_written_in_a_private_folder_with_a_random_name(shared, write):
    folder_names = set()
    for name in ("a.csv", "b.csv"):
        with write(shared / name) as parts:
            part = parts[0] if isinstance(parts, list) else parts
            assert part.name == name and not part.exists()
            assert part.parent.stat().st_mode & 0o777 == 0o700
            folder_names.add(part.parent.name)
            part.write_text("text")
        assert (shared / name).read_text() == "text"
        assert (shared / name).stat().st_mode & 0o777 == 0o666 & ~_umask()
    assert len(folder_names) == 2 and str(os.getpid()) not in "".join(folder_names)
    assert hidden_files(shared) == set()


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_a_link_with_a_guessable_temporary_name_is_not_written_through(shared, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for name in (f".out.csv.{os.getpid()}.part", f".keys.toml.{os.getpid()}"):
        (shared / name).symlink_to(victim)
    write_atomically(shared / "out.csv", "text")
    KeyRing(shared / "keys.toml", create=True).get_or_create_key("00112233445566aa")
    assert victim.read_text() == "precious"
    assert (shared / "out.csv").read_text() == "text"
    assert (shared / "keys.toml").stat().st_mode & 0o777 == 0o600


def test_nothing_is_left_after_a_failure_and_a_folder_has_the_default_permissions(shared):
    for write in (atomic_files, atomic_new_file, atomic_folder):
        with pytest.raises(RuntimeError), write(shared / "x"):
            raise RuntimeError
    assert list(shared.iterdir()) == []
    with atomic_folder(shared / "made") as part:
        (part / "a").write_text("a")
    assert (shared / "made").stat().st_mode & 0o777 == 0o777 & ~_umask()
    assert [path.name for path in shared.iterdir()] == ["made"]


def test_a_link_of_the_same_user_is_followed(shared, tmp_path):
    (tmp_path / "real.toml").write_text("old")
    (shared / "link.toml").symlink_to(tmp_path / "real.toml")
    write_atomically(shared / "link.toml", "new")
    assert (tmp_path / "real.toml").read_text() == "new" and (shared / "link.toml").is_symlink()


@needs_root
def test_a_link_of_another_user_is_refused(shared, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (shared / "out.csv").symlink_to(victim)
    os.lchown(shared / "out.csv", 12345, 12345)
    with pytest.raises(InputError, match="a link of another user"):
        write_atomically(shared / "out.csv", "text")
    assert victim.read_text() == "precious"


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_token_keys_and_private_key_that_others_can_read_are_refused(tmp_path, mode):
    files = {name: tmp_path / name for name in ("token", "keys.toml", "cert.pem", "key.pem")}
    files["token"].write_text("correct-horse-battery")
    files["keys.toml"].write_text("[keys]\n")
    for name in ("cert.pem", "key.pem"):
        files[name].write_text("PEM")
    config = WebConfig(listen="127.0.0.1:0", cert=str(files["cert.pem"]), key=str(files["key.pem"]))
    readers = {
        "token": lambda: read_token(files["token"]),
        "keys.toml": lambda: KeyRing(files["keys.toml"]),
        "key.pem": lambda: web_site(config, {}),
    }
    for name, read in readers.items():
        files[name].chmod(mode)
        with pytest.raises(InputError, match=f"others can read .*; run chmod 600 .*{name}"):
            read()
        files[name].chmod(0o600)
        read()
