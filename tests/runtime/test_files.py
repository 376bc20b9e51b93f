"""Reading files that are not what they seem."""

import os
import sys
from pathlib import Path

import pytest

from giajax import InputError
from giajax.runtime.files import read_bytes

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
    with pytest.raises(InputError, match="has 100 bytes, but may have 99 at most"):
        read_bytes(path, 99)


@pytest.mark.skipif(sys.platform != "linux", reason="such a file is there on Linux alone")
def test_a_file_that_says_no_size_is_not_read_to_its_end():
    """Those of the system have the size 0, and any content."""
    with pytest.raises(InputError, match="has 101 bytes, but may have 100 at most"):
        read_bytes(Path("/proc/self/maps"), 100)
