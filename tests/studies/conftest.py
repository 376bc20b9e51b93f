import pytest
from line import FREE, Line, recorded

import giajax


@pytest.fixture(scope="session")
def runs():
    return [recorded(1, gap=slice(5, 12)), recorded(2)]


@pytest.fixture(scope="session")
def result(runs):
    return giajax.fit(Line(), runs, free=FREE, noise_model="white", check=False)
