"""Types of the public names: `make types` checks this file, and nothing runs it.

Each ignored error must be detected, because mypy reports an unnecessary ignore.
"""

from collections.abc import Callable
from typing import assert_type

import giajax

result = giajax.FitTask.load("fit.toml").on_top(loss="huber").run()
assert_type(result, giajax.FitResult)
assert_type(result.parameters["joints.damping"], giajax.fitting.Estimate)
assert_type(result.parameters["joints.damping"].unit, str)
assert_type(result.runs[0], giajax.fitting.RunFit)
assert_type(giajax.read_run("run.csv"), giajax.Run)

load: Callable[[str], giajax.FitResult] = giajax.load_result

giajax.simulate("takeichi_20m")  # type: ignore[arg-type, call-arg]
giajax.fit(result.model, giajax.read_run("run.csv"), tolerence=1e-9)  # type: ignore[call-arg]
print(giajax.no_such_name)  # type: ignore[attr-defined]
