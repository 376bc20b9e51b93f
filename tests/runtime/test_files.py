"""Reading files whose content is not what it seems."""

import os
import sys
from pathlib import Path

import pytest

from giajax import InputError
from giajax.runtime.execution import run_tasks
from giajax.runtime.files import check_path, parse_json, part_of, read_bytes, written_to
from giajax.runtime.tasks import Task
from giajax.tasks import locked

pytestmark = pytest.mark.quick


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with a name here")
def test_a_pipe_is_refused_without_waiting_for_who_writes_into_it(tmp_path):
    path = tmp_path / "run.csv"
    os.mkfifo(path)
    with pytest.raises(InputError, match="but must be a file"):
        read_bytes(path, 100)


def test_a_file_of_as_many_bytes_as_may_be_is_read(tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(b"a" * 100)
    assert read_bytes(path, 100) == b"a" * 100
    with pytest.raises(InputError, match="has 100 bytes, but at most 99 are allowed"):
        read_bytes(path, 99)


def test_half_a_character_is_refused_wherever_it_is():
    """JSON can contain half of a surrogate pair, but a file or terminal must not."""
    for text in ('{"a": ["\\ud800"]}', '{"\\uDfff": 1}', '["\\ud83d \\ude00"]'):
        with pytest.raises(ValueError, match="incomplete character"):
            parse_json(text, "a.json")
    assert parse_json('["\\ud83d\\ude00"]', "a.json") == ["\N{GRINNING FACE}"]
    assert parse_json('["\\\\ud800"]', "a.json") == ["\\ud800"]


def test_a_circle_of_links_is_no_path(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    for path in (tmp_path / "a", tmp_path / "a" / "c"):
        with pytest.raises(InputError, match="cannot be used"):
            check_path(path)
    (tmp_path / "dangling").symlink_to("nowhere")
    check_path(tmp_path / "dangling")


@pytest.mark.skipif(not os.access("/proc/kmsg", os.R_OK), reason="of who may read the kernel's log")
def test_a_file_that_has_nothing_to_say_yet_is_not_waited_for():
    assert len(read_bytes(Path("/proc/kmsg"), 1 << 26)) >= 0


@pytest.mark.skipif(sys.platform != "linux", reason="such a file is there on Linux alone")
def test_a_file_that_says_no_size_is_not_read_to_its_end():
    """System files have the size 0, but may have any content."""
    with pytest.raises(InputError, match="has 101 bytes, but at most 100 are allowed"):
        read_bytes(Path("/proc/self/maps"), 100)


@pytest.mark.skipif(os.name != "posix", reason="of POSIX locks")
def test_what_a_killed_writer_left_is_removed_with_the_next_task_or_fit(tmp_path):
    """Files that giajax did not name are kept, and so are recent files of other processes."""

    def leave(folder):
        names = {"old": part_of(folder / "a"), "new": part_of(folder / "b")}
        names["other"] = folder / ".mine.part"
        for path in names.values():
            path.write_bytes(b"torn")
        for name in ("old", "other"):
            os.utime(names[name], (0, 0))
        return names

    left = {}
    for folder in (tmp_path / "tasks", tmp_path / "fit"):
        folder.mkdir()
        left |= {folder.name: leave(folder)}

    def there(folder):
        return {name for name, path in left[folder].items() if path.exists()}

    with written_to(tmp_path / "tasks"):
        assert there("tasks") == {"other"}
        left["tasks"] = leave(tmp_path / "tasks")
        run_tasks([Task("os:getcwd")], folder=tmp_path / "tasks")
        assert there("tasks") == {"new", "other"}
    run_tasks([Task("os:getcwd")], folder=tmp_path / "tasks")
    assert there("tasks") == {"other"}
    with locked(tmp_path / "fit"):
        assert there("fit") == {"other"}
        with written_to(tmp_path / "fit"):
            pass
    with written_to(tmp_path / "none" / "yet"):
        assert (tmp_path / "none" / "yet").exists()
    assert not (tmp_path / "none").exists()
