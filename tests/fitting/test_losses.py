"""Losses: those of giajax, a user-defined one, and invalid ones."""

import json
import tomllib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

import giajax
from giajax import InputError
from giajax.fitting import (
    AbstractLoss,
    BlockJacobian,
    Huber,
    Linear,
    SoftL1,
    StudentT,
    check_loss,
    loss_of,
    uncertainty,
)
from toy_model import TRUTH, Decay, run

LOSSES = [Linear(), Huber(), SoftL1(), StudentT(), StudentT(degrees_of_freedom=1.0)]


def textbook(loss, r):
    """Return scipy's definitions in terms of z = r^2; the t density is scaled to be normal at 0."""
    z = r * r
    if isinstance(loss, StudentT):
        nu = loss.degrees_of_freedom
        density = stats.t(nu, scale=np.sqrt((nu + 1) / nu))
        return -2 * (density.logpdf(r) - density.logpdf(0.0))
    if loss == Huber():
        return np.where(z <= 1, z, 2 * np.sqrt(z) - 1)
    return z if loss == Linear() else 2 * (np.sqrt(1 + z) - 1)


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_loss_is_the_square_of_its_transformation_and_its_derivatives_are_its_differences(loss):
    # Include 0 and both sides of Huber's corner.
    r = np.concatenate([np.linspace(-6.0, 6.0, 241), [0.0, -0.0, 1e-9, 1 - 1e-7, 1 + 1e-7, 1e4]])
    t = np.asarray(loss.transform(jnp.asarray(r)))
    found, rho = loss.scores(r), textbook(loss, r)
    np.testing.assert_allclose(t**2, rho, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.rho, rho, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(np.sign(t), np.sign(r))
    for derivative in (jax.grad, jax.jacfwd):
        numeric = jax.vmap(derivative(loss.transform))(jnp.asarray(r))
        np.testing.assert_allclose(found.slope, numeric, atol=1e-12)
    h = 1e-5
    ahead, behind = loss.scores(r + h), loss.scores(r - h)
    differences = (ahead.rho - behind.rho) / (4 * h)
    np.testing.assert_allclose(found.psi, differences, rtol=1e-7, atol=1e-5)
    np.testing.assert_allclose(found.psi, found.slope * t, rtol=1e-12, atol=1e-14)
    smooth = np.abs(np.abs(r) - 1) > 0.01
    curvature = (ahead.psi - behind.psi) / (2 * h)
    np.testing.assert_allclose(found.curvature[smooth], curvature[smooth], atol=1e-6)


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_its_efficiency_is_that_of_quadrature(loss):
    def mean(of):
        density = stats.norm.pdf
        parts = zip((-40.0, -1.0, 1.0), (-1.0, 1.0, 40.0), strict=True)
        return sum(integrate.quad(lambda r: of(r) * density(r), *part)[0] for part in parts)

    def psi(r, step=1e-5):
        return (textbook(loss, r + step) - textbook(loss, r - step)) / (4 * step)

    square, pull = mean(lambda r: psi(r) ** 2), mean(lambda r: r * psi(r))
    assert loss.mean_square == pytest.approx(square, rel=1e-5)
    assert loss.efficiency == pytest.approx(pull**2 / square, rel=1e-5)
    known = {Huber(): 0.903, Linear(): 1.0, StudentT(): 0.942}
    if loss in known:
        assert loss.efficiency == pytest.approx(known[loss], abs=5e-4)


@pytest.mark.parametrize("loss", LOSSES[1:], ids=repr)
def test_far_off_a_step_is_that_of_reweighted_least_squares_and_at_the_end_that_of_newton(loss):
    """Check the factors that multiply the Jacobian of t, for a table of residuals."""
    few, many = np.linspace(-3.0, 3.0, 60), np.linspace(-30.0, 30.0, 60)
    few[np.abs(few) > 0.9] *= 0.2
    few[::20] = [-8.0, 5.0, 12.0]
    for r, far in ((few, 0.05), (many, 1.0)):
        _, psi, curvature, slope = loss.scores(r)
        ratio = np.asarray(loss.curvature_ratio(jnp.asarray(r), jnp.ones(60)))
        expected = far * psi / r + (1 - far) * np.maximum(curvature, 0)
        np.testing.assert_allclose((ratio * slope) ** 2, expected, rtol=1e-9)


def spread(residual, jacobian, loss, columns):
    measured = np.ones(len(residual), bool)
    return uncertainty(
        residual, BlockJacobian.dense(jacobian), loss=loss, measured=measured, columns=columns
    )


def test_huber_without_a_residual_inside_its_corner_still_has_an_error():
    rng = np.random.default_rng(5)
    residual, jacobian = 100 * rng.choice([-1.0, 1.0], 30), rng.normal(size=(30, 2)) * 0.01
    found = spread(residual, jacobian, Huber(), np.arange(2))
    assert np.all(np.isfinite(found.covariance))
    assert found.scale > 1000


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_standard_errors_are_the_spread_of_repeated_fits(loss):
    """A straight line fitted 400 times: the standard errors must equal the observed spread."""
    rng = np.random.default_rng(3)
    x = np.linspace(-1.0, 1.0, 80)
    design = np.stack([np.ones_like(x), x], axis=1)
    y = design @ [1.0, 2.0] + rng.standard_t(4, size=(400, x.size)) / np.sqrt(2)
    estimates = np.zeros((400, 2))
    for _ in range(40):
        r = estimates @ design.T - y
        weights = np.where(r == 0, 1.0, loss.scores(r).psi / np.where(r == 0, 1.0, r))
        matrices = np.einsum("ij,jk,jl->ikl", weights, design, design)
        estimates = np.linalg.solve(matrices, ((weights * y) @ design)[..., None])[..., 0]
    claimed = []
    for each in estimates @ design.T - y:
        found = spread(each, design * loss.scores(each).slope[:, None], loss, np.arange(2))
        claimed.append(np.sqrt(np.diag(found.covariance)))
    seen = np.std(estimates, axis=0)
    np.testing.assert_allclose(np.mean(claimed, axis=0), seen, rtol=0.12)


@giajax.register
class Cauchy(AbstractLoss):
    """Cauchy loss with a given width."""

    width: float = 2.0

    def rho(self, r):
        return self.width**2 * jnp.log1p((r / self.width) ** 2)


@pytest.fixture(scope="module")
def wild():
    """A decay in which one sample in ten is off by half a metre."""
    clean = run(samples=100, seed=2)
    heights = clean.observations["tip_z"].copy()
    heights[::10] += 0.5
    return giajax.Run.from_arrays(
        clean.times, {"tip_z": heights}, noise={"position": 0.01}, definition={"free_motion": True}
    )


def fitted(recording, loss):
    # One step from the optimum, or 50 noise deviations; at twice that, Student-t has a local
    # optimum.
    start = {"amplitude": 1.5, "decay": 1.0, "offset": 0.2}
    return giajax.fit(Decay(), recording, loss=loss, start=start, noise_model="white", check=False)


@pytest.mark.parametrize(
    ("loss", "stated"),
    [
        (StudentT(degrees_of_freedom=3.0), {"name": "student_t", "degrees_of_freedom": 3.0}),
        ("student_t", {"name": "student_t", "degrees_of_freedom": 4.0}),
        ({"name": "student_t", "degrees_of_freedom": 4}, None),
        (Cauchy(), {"name": "Cauchy", "width": 2.0}),
        ("huber", "huber"),
    ],
)
def test_a_fit_with_outliers_is_at_the_truth_by_words_tables_and_objects(wild, loss, stated):
    result = fitted(wild, loss)
    assert result.status == "converged"
    for path, value in TRUTH.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3.5 * estimate.standard_error, path
    stated = {**loss, "degrees_of_freedom": 4.0} if stated is None else stated
    assert result.config["loss"] == stated
    assert json.loads(result.to_json())["config"]["loss"] == stated
    assert result.loss == loss_of(stated)
    off = fitted(wild, "linear").parameters["offset"].value - TRUTH["offset"]
    assert abs(off) > 10 * result.parameters["offset"].standard_error
    assert ("test_losses.py" in result.versions) == (result.loss == Cauchy())


def test_settings_state_a_loss_by_what_a_file_would():
    settings = giajax.FitSettings(loss=StudentT(degrees_of_freedom=2.5))
    assert settings.loss == {"name": "student_t", "degrees_of_freedom": 2.5}
    task = giajax.FitTask(giajax.Definition()).on_top(loss=Cauchy(width=3.0))
    text = task.definition.to_toml()
    assert giajax.Definition.parse(tomllib.loads(text)) == task.definition
    assert task.on_top(loss="linear").definition.fit.loss == "linear"


class Local(Cauchy):
    """A loss that is not registered."""


@giajax.register
class Listed(Cauchy):
    """A loss with a value that a file cannot contain."""

    width: object = (1.0, 2.0)


@giajax.register
class Named(AbstractLoss):
    """A loss with a parameter name that files reserve."""

    name: float = 2.0

    def rho(self, r):
        return r**2


@giajax.register
class Powers(AbstractLoss):
    """A loss with an integer parameter."""

    terms: int = 2

    def rho(self, r):
        return 4 * sum(((r / 2) ** 2 / (1 + (r / 2) ** 2)) ** k for k in range(1, 1 + self.terms))


def test_parameters_are_numbers_of_python_or_numpy_and_keep_their_type():
    for number in (np.float32(3), np.int64(3), 3.0):
        stated = StudentT(number).contents()
        assert type(stated["degrees_of_freedom"]) in (int, float)
        assert loss_of(stated) == StudentT(3.0)
    assert type(loss_of({"name": "Powers", "terms": 3}).terms) is int
    check_loss(Powers(terms=3))
    for wrong in (StudentT(jnp.asarray(3.0)), Cauchy(jnp.asarray(3.0))):
        with pytest.raises(
            InputError, match="which cannot be stored in a file: give a finite number"
        ):
            check_loss(wrong)
    with pytest.raises(InputError, match=r"StudentT.* is not a loss: give an instance"):
        check_loss(StudentT)


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ("cauchy", "fit.loss = 'cauchy' must be \"linear\", .*: correct the name, or give --plug"),
        (3, "fit.loss = 3 must be"),
        ({"degrees_of_freedom": 3}, "fit.loss = .* must be"),
        (Local(), "the loss Local is not registered, so a result cannot refer to it"),
        (StudentT, r"fit.loss = .*StudentT.* must be \"linear\""),
        (Named(), "the loss Named has a parameter called 'name', which is reserved in files"),
        ({"name": "student_t", "degrees_of_freedom": "3"}, "the loss student_t cannot be created"),
        (Listed(), r"the loss Listed has width = \(1.0, 2.0\), which cannot be stored in a file"),
        (
            {"name": "student_t", "nu": 3},
            r"the loss student_t cannot be created \(.*'nu'\): give num",
        ),
        ({"name": "huber", "k": "wide"}, "the loss huber cannot be created"),
        ({"name": "student_t", "degrees_of_freedom": -1}, "student_t has -1 degrees of freedom"),
    ],
)
def test_what_names_no_loss_is_refused(said, sentence):
    with pytest.raises(InputError, match=sentence):
        giajax.fit(Decay(), run(), loss=said)


CASES = {
    "Shapeless": (
        lambda r: jnp.sum(r**2),
        r"returns an array of shape \(\) for residuals of shape",
    ),
    "Broken": (lambda r: r.square, r"fails \(AttributeError: .*square"),
    "Negative": (lambda r: jnp.where(r > 3, -1.0, r**2), "is negative at r = 3"),
    "Uneven": (lambda r: jnp.where(r > 2, r, r**2), "differs from its value at -r at r = 2"),
    "Double": (lambda r: 2 * jnp.log1p(r**2), r"is 0 \+ 2 r\^2 near r = 0, but must be r"),
    "Lifted": (lambda r: 1 + r**2, r"is 1 \+ 1 r\^2 near"),
    "Rooted": (lambda r: jnp.abs(r) * jnp.sqrt(r**2), "has a derivative that is not finite at"),
    "Missing": (lambda r: jnp.where(r > 9, jnp.nan, r**2), "has a value that is not finite at"),
    "Jumping": (lambda r: jnp.where(jnp.abs(r) < 3, 1, 3) * r**2, "is not the integral of its"),
    "Steep": (lambda r: r**2 + 100 * jnp.abs(r) ** 3, r"deviates from r\^2 near 0 at r = 0.001"),
    "Halved": (
        lambda r: r.astype(jnp.float32) ** 2,
        "returns float32 for residuals of type float64",
    ),
    "Together": (
        lambda r: jnp.log1p((r / (s := jnp.maximum(jnp.median(jnp.abs(r)), 1.0))) ** 2) * s**2,
        "depends on the other residuals at r",
    ),
    "Falling": (lambda r: r**2 * jnp.exp(-(r**2) / 9), "decreases for larger residuals at r = 3"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_wrong_loss_is_refused_before_anything_is_fitted(name):
    rho, said = CASES[name]
    body = {"rho": lambda self, r: rho(r), "__module__": f"wrong_{name.lower()}"}
    wrong = giajax.register(type(name, (AbstractLoss,), body))
    with pytest.raises(InputError, match=f"{name}.rho {said}"):
        giajax.fit(Decay(), run(), loss=wrong())


def test_only_rho_is_a_losss_own():
    """`is_linear` and other methods follow from rho, so a loss must not override them."""

    class Derived(Linear):
        def rho(self, r):
            return 4 * jnp.log1p((r / 2) ** 2)

    class Claiming(Cauchy):
        is_linear = True

    for wrong, name in ((Derived(), "transform"), (Claiming(), "is_linear")):
        with pytest.raises(InputError, match=f"defines {name}, which is derived from rho"):
            check_loss(wrong)
    assert not Derived().is_linear


@giajax.register
class Tukey(AbstractLoss):
    """Tukey's loss, which is constant beyond a width."""

    width: float = 4.685

    def rho(self, r):
        u = jnp.clip(r / self.width, -1, 1)
        return self.width**2 / 3 * (1 - (1 - u**2) ** 3)


def test_a_cell_where_rho_is_level_has_no_part_in_a_fit():
    clean = run(samples=100, seed=2)
    heights = clean.observations["tip_z"].copy()
    heights[::25] += 0.5
    recording = giajax.Run.from_arrays(
        clean.times, {"tip_z": heights}, noise={"position": 0.01}, definition={"free_motion": True}
    )
    start = {"amplitude": 1.95, "decay": 0.72, "offset": 0.3}
    for noise_model in ("white", "correlated"):
        result = giajax.fit(
            Decay(), recording, loss=Tukey(), start=start, noise_model=noise_model, check=False
        )
        assert result.status == "converged"
        for path, value in TRUTH.items():
            estimate = result.parameters[path]
            assert abs(estimate.value - value) < 3.5 * estimate.standard_error, path


def test_each_loss_weighs_outliers_among_correlated_noise():
    clean, rng = run(samples=200, seed=2), np.random.default_rng(0)
    noise = np.zeros(200)
    for at in range(1, 200):
        noise[at] = 0.9 * noise[at - 1] + 0.02 * rng.normal()
    heights = clean.observations["tip_z"] + noise
    heights[::15] += 0.5
    recording = giajax.Run.from_arrays(
        clean.times, {"tip_z": heights}, definition={"free_motion": True}
    )
    start = {"amplitude": 1.5, "decay": 1.0, "offset": 0.2}
    ends = {}
    for loss in ("huber", "soft_l1", "student_t"):
        result = giajax.fit(Decay(), recording, loss=loss, start=start, check=False)
        assert result.status == "converged"
        assert result.runs[0].channels["tip_z"].correlated > 0
        ends[loss] = result.parameters["offset"]
    values = [each.value for each in ends.values()]
    error = ends["huber"].standard_error
    assert min(np.abs(np.diff([*values, values[0]]))) > 0.01 * error
    # Cells that are half a metre off affect the Huber fit, but hardly the Student-t fit.
    assert ends["huber"].value - ends["student_t"].value > 0.2 * error


def test_a_loss_without_its_method_is_refused_by_its_name():
    with pytest.raises(InputError, match="Unfinished lacks rho: implement it"):

        @giajax.register
        class Unfinished(AbstractLoss):
            pass


def test_right_ones_pass_also_where_they_level_off():
    class Level(AbstractLoss):
        def rho(self, r):
            return jnp.where(jnp.abs(r) < 4, 16 / 3 * (1 - (1 - r**2 / 16) ** 3), 16 / 3)

    for loss in (Cauchy(), Cauchy(width=0.5), Level()):
        check_loss(loss)
    ratio = Level().curvature_ratio(jnp.asarray([0.0, 1.0, 9.0]), jnp.ones(3))
    assert np.all(np.isfinite(ratio))
    assert eqx.tree_equal(loss_of("Cauchy"), Cauchy())
