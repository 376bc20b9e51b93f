import pytest

from giajax.fitting import fit
from giajax.models import model_for
from small_arm import START, small_run


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    return small_run(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="session")
def result(run):
    return fit(model_for([run]), run, start=START)
