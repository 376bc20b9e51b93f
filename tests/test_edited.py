"""After an edit of the source, programs that were cached before are not used."""

import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import giajax
from small_loops import write_task

PACKAGE = Path(giajax.__file__).parent


def programs(home):
    """Return the number of cached programs after a fit with the copied package."""
    words = ["fit", "loops_fit.toml", "--no-figures", "--quiet", "--out", "out", "--force"]
    environment = {
        **os.environ,
        "PYTHONPATH": str(home / "copy"),
        "JAX_COMPILATION_CACHE_DIR": str(home / "cache"),
    }
    # As with `python -m giajax`, and with the other command in the same process.
    code = (
        "import sys\nfrom giajax.__main__ import main\nassert main() == 0\n"
        "from giajax.cli import main\nsys.exit(main(['cache']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=home, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("traced"))
    return int(line.split()[1])


@pytest.mark.slow
def test_an_edit_of_the_physics_makes_other_programs(tmp_path):
    """This holds for any folder, with either way to look up the cached programs."""
    shutil.copytree(PACKAGE, tmp_path / "copy" / "giajax")
    write_task(tmp_path)
    first = programs(tmp_path)
    assert first > 0
    assert programs(tmp_path) == first
    edited = [giajax.mechanics.arm.drag_force, giajax.simulate]
    for number, code in enumerate(edited, 2):
        source = Path(inspect.getsourcefile(inspect.unwrap(code))).relative_to(PACKAGE)
        with (tmp_path / "copy" / "giajax" / source).open("a") as file:
            file.write("\n# edited\n")
        assert programs(tmp_path) == number * first, source
