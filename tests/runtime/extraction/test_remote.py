"""Which images a URL stands for, and what they are called."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from elf_runtime.errors import ElfError, ImageError
from elf_runtime.extraction.remote import _Address, remote_images


def test_images_are_found_where_fsspec_reaches(tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec", reason="needs the extra ray")
    from runtime.extraction.disk import Disk

    fsspec.register_implementation("disk", Disk, clobber=True)
    for name in ("b.jpg", "a.jpg", "x/c.jpg", ".hidden.jpg", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    url = f"disk://{tmp_path.as_posix()}"

    def names(place: str, recursive: bool = False, base: str | None = None) -> list[str]:
        return [image.stem.as_posix() for image in remote_images(place, recursive, {".jpg"}, base)]

    assert names(url) == ["a.jpg", "b.jpg"]
    assert names(url, recursive=True) == ["a.jpg", "b.jpg", "x/c.jpg"]
    assert names(f"{url}/*/*.jpg") == ["c.jpg"]
    assert names(f"{url}/*/*.jpg", base=url) == ["x/c.jpg"]
    assert names(f"{url}/gone.jpg") == ["gone.jpg"]
    assert names(f"{url}/x/*.png") == []
    with pytest.raises(ElfError, match="not below it"):
        names(f"{url}/a.jpg", base=f"{url}/x")
    (image,) = remote_images(f"{url}/gone.jpg", False, {".jpg"})
    with pytest.raises(ImageError, match=r"gone\.jpg"):
        image.open(None)


def test_a_name_that_exists_comes_before_a_pattern(tmp_path: Path) -> None:
    pytest.importorskip("fsspec", reason="needs the extra ray")

    for name in ("[1].jpg", "1.jpg", "[x]/2.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")

    def urls(place: str) -> list[str]:
        return [image.name for image in remote_images(f"file://{tmp_path}/{place}", False, {".jpg"})]

    assert urls("[1].jpg") == [f"file://{tmp_path}/[1].jpg"]
    assert urls("[x]") == [f"file://{tmp_path}/[x]/2.jpg"]
    assert urls("[12].jpg") == [f"file://{tmp_path}/1.jpg"]


def test_images_of_archives_are_named_with_them(tmp_path: Path) -> None:
    """By a URL that fsspec opens again, and among the results by the archive's file name."""
    fsspec = pytest.importorskip("fsspec", reason="needs the extra ray")

    def found(url: str, base: str | None = None) -> dict[str, str]:
        images = remote_images(url, True, {".jpg"}, base)
        for image in images:
            with fsspec.open(image.name, "rb") as file:
                assert file.read() == image.stem.name.encode()
        return {image.stem.as_posix(): image.name for image in images}

    for archive in ("a.zip", "b.zip"):
        with zipfile.ZipFile(tmp_path / archive, "w") as file:
            file.writestr("1.jpg", "1.jpg")
            file.writestr("x/1.jpg", "1.jpg")
    for archive in ("a.zip", "b.zip"):
        place = f"::file://{tmp_path}/{archive}"
        expected = {f"{archive}/{name}": f"zip://{name}{place}" for name in ("1.jpg", "x/1.jpg")}
        assert found(f"zip://{place}") == expected
        assert found(f"zip{place}") == expected
        assert found(f"zip://x/*.jpg{place}") == {f"{archive}/1.jpg": f"zip://x/1.jpg{place}"}
        assert found(f"zip://x{place}", f"zip://{place}") == {"x/1.jpg": f"zip://x/1.jpg{place}"}
    (tmp_path / "1.jpg").write_bytes(b"1.jpg")
    assert found(f"simplecache::file://{tmp_path}/1.jpg") == {"1.jpg": f"file://{tmp_path}/1.jpg"}


def test_a_password_is_no_part_of_a_name() -> None:
    class Sftp:
        def unstrip_protocol(self, path: str) -> str:
            return f"sftp://{path}"

    for host, name in (("one", "sftp://one/x/1.jpg"), ("me:secret@one", "sftp:///x/1.jpg")):
        assert _Address.of(f"sftp://{host}/x/", Sftp(), "/x").of_path("/x/1.jpg") == name
