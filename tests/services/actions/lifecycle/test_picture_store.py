"""Which pictures stay on the disk, and for how long."""

import gc
from collections.abc import Callable
from pathlib import Path

import pytest

from jezero.schemas.images import ImageReply
from jezero.services.actions.lifecycle.picture_store import PictureStore


def picture(goal_id: str, index: int) -> ImageReply:
    """A picture of 1200 bytes, and some more for its numbers."""
    return ImageReply(goal_id=goal_id, index=index, width_px=20, height_px=20, pixels=bytes(1200))


def there(store: PictureStore, goal_id: str, index: int = 0) -> bool:
    found = store.get(goal_id, index)
    assert (found.goal_id, found.index) == (goal_id, index)
    assert bool(found.pixels) is not bool(found.reason)
    return bool(found.pixels)


def test_the_oldest_goals_lose_their_pictures_when_there_are_too_many_but_never_the_newest(tmp_path: Path) -> None:
    store = PictureStore(tmp_path, size_max_bytes=8000)
    for goal_id in ("a", "b"):
        for index in range(2):
            store.keep(picture(goal_id, index))
    assert there(store, "a") and there(store, "a", 1) and there(store, "b")
    for index in range(3):
        store.keep(picture("c", index))
    assert [there(store, goal_id) for goal_id in "abc"] == [False, True, True]
    for index in range(3, 9):
        store.keep(picture("c", index))
    assert [there(store, goal_id) for goal_id in "abc"] == [False, False, True]
    assert there(store, "c", 8)


def test_pictures_of_an_earlier_run_are_deleted(tmp_path: Path) -> None:
    PictureStore(tmp_path).keep(picture("a", 0))
    assert not there(PictureStore(tmp_path), "a")


def test_a_temporary_folder_is_deleted_with_its_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    store = PictureStore()
    store.keep(picture("a", 0))
    assert there(store, "a") and list(tmp_path.iterdir())
    del store
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_a_given_folder_outlives_its_store(tmp_path: Path) -> None:
    store = PictureStore(tmp_path)
    store.keep(picture("a", 0))
    del store
    gc.collect()
    assert [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_picture_that_the_disk_has_spoiled_is_none_and_the_reason_says_so(tmp_path: Path) -> None:
    store = PictureStore(tmp_path)
    store.keep(picture("a", 3))
    (file,) = (path for path in tmp_path.rglob("*") if path.is_file())
    file.write_bytes(b"spoiled")
    assert not there(store, "a", 3)
    assert "picture 3 of goal a can't be read" in store.get("a", 3).reason


def test_pictures_that_wait_for_the_disk_are_served_and_limited(tmp_path: Path) -> None:
    work: list[Callable[[], None]] = []
    store = PictureStore(tmp_path, execute=work.append, unwritten_max_bytes=3500)
    store.keep(picture("a", 0))
    store.keep(picture("a", 1))
    assert there(store, "a") and there(store, "a", 1)
    with pytest.raises(OSError, match="the disk doesn't keep up"):
        store.keep(picture("a", 2))
    assert not there(store, "a", 2)
    for write in work:
        write()
    store.keep(picture("a", 2))
    assert there(store, "a", 2)


def test_at_most_64_megabytes_wait_in_memory_for_a_busy_disk(tmp_path: Path) -> None:
    store = PictureStore(tmp_path, execute=lambda work: None)
    store.keep(ImageReply(goal_id="a", index=0, pixels=bytes(60_000_000)))
    with pytest.raises(OSError, match="the disk doesn't keep up"):
        store.keep(ImageReply(goal_id="a", index=1, pixels=bytes(10_000_000)))


def test_a_disk_that_fails_late_is_named_with_the_next_picture_of_the_same_goal_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    work: list[Callable[[], None]] = []
    store = PictureStore(tmp_path / "file" / "pictures", execute=work.append)
    store.keep(picture("a", 0))
    work.pop()()
    with pytest.raises(NotADirectoryError):
        store.keep(picture("a", 1))
    late = work.pop()
    store.keep(picture("b", 0))
    late()
    store.keep(picture("b", 1))
