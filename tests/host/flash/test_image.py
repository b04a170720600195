"""The firmware image: files compiled for each processor."""

import re

import pytest

from hubodo.flash.image import (
    ARCHITECTURES,
    ImageError,
    build_image,
    firmware_folder,
    hash_files,
    needs_native,
    read_sources,
)


def test_all_files_except_main_are_compiled():
    image = build_image(firmware_folder(), "armv6m")
    assert "main.py" in image
    assert {name for name in image if name.endswith(".py")} == {"main.py"}
    assert {name.removesuffix(".mpy").removesuffix(".py") for name in image} == {
        name.removesuffix(".py") for name in read_sources(firmware_folder())
    }


def test_an_image_of_bytecode_leaves_out_files_with_native_code():
    left_out = set(read_sources(firmware_folder())) - {
        re.sub(r"\.mpy$", ".py", name) for name in build_image(firmware_folder(), None)
    }
    assert left_out == {name for name, text in read_sources(firmware_folder()).items() if needs_native(text)}


def test_compiled_native_files_name_their_architecture():
    """The architecture number is in bits 2 to 6 of byte 2 of a .mpy file (py/persistentcode.h)."""
    native = [
        name.removesuffix(".py") + ".mpy"
        for name, text in read_sources(firmware_folder()).items()
        if needs_native(text)
    ]
    for architecture in ("armv6m", "xtensawin"):
        image = build_image(firmware_folder(), architecture)
        for name in native:
            assert image[name][0:1] == b"M"
            assert image[name][2] >> 2 & 0x1F == ARCHITECTURES.index(architecture)


def test_the_image_is_reproducible():
    assert hash_files(build_image(firmware_folder(), None)) == hash_files(
        build_image(firmware_folder(), None)
    )


def test_a_file_that_does_not_compile_is_named(tmp_path):
    (tmp_path / "main.py").write_text("import broken\n")
    (tmp_path / "broken.py").write_text("def f(:\n")
    with pytest.raises(ImageError, match=r"broken\.py: mpy-cross: .*SyntaxError"):
        build_image(tmp_path, None)
