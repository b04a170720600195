"""What is written beside others who may write to the folder, and what is read only where nobody else can."""

import os

import pytest

from hubodo.atomic_files import atomic_files, atomic_folder, atomic_new_file, write_atomically
from hubodo.errors import InputError
from hubodo.ingest.link.keys import KeyRing
from hubodo.web.config import WebConfig, read_token, web_site

root = pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs two users")


@pytest.fixture
def shared(tmp_path):
    """A folder that everybody may write to."""
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o777)
    return folder


def names(folder):
    return {path for path in folder.iterdir() if path.name.startswith(".")}


@pytest.mark.parametrize("write", [atomic_files, atomic_new_file])
def test_a_file_is_written_in_a_folder_of_a_random_name_that_only_its_owner_can_enter(shared, write):
    seen = set()
    for name in ("a.csv", "b.csv"):
        with write(shared / name) as parts:
            part = parts[0] if isinstance(parts, list) else parts
            assert part.name == name and not part.exists()
            assert part.parent.stat().st_mode & 0o777 == 0o700
            seen.add(part.parent.name)
            part.write_text("text")
        assert (shared / name).read_text() == "text"
        assert (shared / name).stat().st_mode & 0o777 == 0o666 & ~_umask()
    assert len(seen) == 2 and str(os.getpid()) not in "".join(seen)
    assert names(shared) == set()


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_a_link_under_the_name_that_used_to_be_taken_is_not_written_through(shared, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for name in (f".out.csv.{os.getpid()}.part", f".keys.toml.{os.getpid()}"):
        (shared / name).symlink_to(victim)
    write_atomically(shared / "out.csv", "text")
    KeyRing(shared / "keys.toml", create=True).get_or_create_key("00112233445566aa")
    assert victim.read_text() == "precious"
    assert (shared / "out.csv").read_text() == "text"
    assert (shared / "keys.toml").stat().st_mode & 0o777 == 0o600


def test_nothing_is_left_after_a_failure_and_a_folder_has_the_usual_rights(shared):
    for write in (atomic_files, atomic_new_file, atomic_folder):
        with pytest.raises(RuntimeError), write(shared / "x"):
            raise RuntimeError
    assert list(shared.iterdir()) == []
    with atomic_folder(shared / "made") as part:
        (part / "a").write_text("a")
    assert (shared / "made").stat().st_mode & 0o777 == 0o777 & ~_umask()
    assert [path.name for path in shared.iterdir()] == ["made"]


def test_a_link_of_the_users_own_is_followed_to_what_it_names(shared, tmp_path):
    (tmp_path / "real.toml").write_text("old")
    (shared / "link.toml").symlink_to(tmp_path / "real.toml")
    write_atomically(shared / "link.toml", "new")
    assert (tmp_path / "real.toml").read_text() == "new" and (shared / "link.toml").is_symlink()


@root
def test_a_link_that_another_user_made_is_refused(shared, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (shared / "out.csv").symlink_to(victim)
    os.lchown(shared / "out.csv", 12345, 12345)
    with pytest.raises(InputError, match="a link of another user"):
        write_atomically(shared / "out.csv", "text")
    assert victim.read_text() == "precious"


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_token_keys_and_private_key_that_others_can_read_are_refused_alike(tmp_path, mode):
    files = {name: tmp_path / name for name in ("token", "keys.toml", "cert.pem", "key.pem")}
    files["token"].write_text("correct-horse-battery")
    files["keys.toml"].write_text("[keys]\n")
    for name in ("cert.pem", "key.pem"):
        files[name].write_text("PEM")
    config = WebConfig(listen="127.0.0.1:0", cert=str(files["cert.pem"]), key=str(files["key.pem"]))
    reads = {
        "token": lambda: read_token(files["token"]),
        "keys.toml": lambda: KeyRing(files["keys.toml"]),
        "key.pem": lambda: web_site(config, {}),
    }
    for name, read in reads.items():
        files[name].chmod(mode)
        with pytest.raises(InputError, match=f"others can read .*; run chmod 600 .*{name}"):
            read()
        files[name].chmod(0o600)
        read()
