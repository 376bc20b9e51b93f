"""Sections of a definition for noise, uncertainty, the fit, and the figures it must reach."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self, TypedDict, get_args

import numpy.typing as npt
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from ..runtime.limits import STARTS
from ..runtime.plugins import registered
from ..runtime.solvers import as_text, from_text
from ..runtime.text import InputError, shown
from ..schema import (
    NOISE_KEYS,
    QUANTITY_OF_SUFFIX,
    Expression,
    Finite,
    Name,
    Positive,
    Prior,
    Section,
    flat,
    key,
)
from ._channels import Channel, column_table, from_si, parse_column, to_si

DURATION = r"^[0-9]{1,9}(\.[0-9]{1,9})?[smh]$"
"""Pattern of a duration: a number followed by its unit."""

_SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0}


def seconds_of(duration: str) -> float:
    """Convert a duration that matches `DURATION` to seconds.

    Example:
        >>> seconds_of("1.5h")
        5400.0
    """
    return float(duration[:-1]) * _SECONDS[duration[-1]]


Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]

_NOISE = "a positive number, the standard deviation"
_TIME = "a positive number of seconds"


class Noise(Section):
    """`[noise]`: standard deviations of the noise of one value, by quantity or by column.

    A part of the noise may be correlated in time, with the autocorrelation exp(-|dt| / time).
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow", strict=True, frozen=True)
    __pydantic_extra__: dict[str, Positive] = Field(init=False)

    position_m: Positive | None = key(
        _NOISE, "standard deviation of the noise of every position", example=0.01
    )
    angle_deg: Positive | None = key(
        _NOISE, "standard deviation of the noise of every angle", example=0.5
    )
    rate_deg_per_s: Positive | None = key(
        _NOISE, "standard deviation of the noise of every joint rate", example=1.0
    )
    pixel_px: Positive | None = key(
        _NOISE, "standard deviation of the noise of every image coordinate", example=2.0
    )
    acceleration_m_per_s2: Positive | None = key(
        _NOISE, "standard deviation of the noise of every acceleration", example=0.05
    )
    position_correlated_m: Positive | None = key(
        _NOISE, "standard deviation of the correlated part of position_m"
    )
    position_correlation_s: Positive | None = key(
        _TIME, "correlation time of position_correlated_m"
    )
    angle_correlated_deg: Positive | None = key(
        _NOISE, "standard deviation of the correlated part of angle_deg"
    )
    angle_correlation_s: Positive | None = key(_TIME, "correlation time of angle_correlated_deg")
    rate_correlated_deg_per_s: Positive | None = key(
        _NOISE, "standard deviation of the correlated part of rate_deg_per_s"
    )
    rate_correlation_s: Positive | None = key(
        _TIME, "correlation time of rate_correlated_deg_per_s"
    )
    pixel_correlated_px: Positive | None = key(
        _NOISE, "standard deviation of the correlated part of pixel_px"
    )
    pixel_correlation_s: Positive | None = key(_TIME, "correlation time of pixel_correlated_px")
    acceleration_correlated_m_per_s2: Positive | None = key(
        _NOISE, "standard deviation of the correlated part of acceleration_m_per_s2"
    )
    acceleration_correlation_s: Positive | None = key(
        _TIME, "correlation time of acceleration_correlated_m_per_s2"
    )

    def correlated_part(self, name: str) -> tuple[float, float] | None:
        """Return the standard deviation (unit of the key) and time (s) of the correlated part."""
        quantity, _, unit = name.partition("_")
        deviation = getattr(self, f"{quantity}_correlated_{unit}")
        time_s = getattr(self, f"{quantity}_correlation_s")
        return None if deviation is None or time_s is None else (deviation, time_s)

    @property
    def columns(self) -> dict[str, float]:
        """Standard deviations by column name, in the unit of the column."""
        return dict(self.__pydantic_extra__ or {})

    @model_validator(mode="after")
    def _a_correlated_part_is_whole(self) -> "Noise":
        for name in NOISE_KEYS:
            quantity, _, unit = name.partition("_")
            part, time = f"{quantity}_correlated_{unit}", f"{quantity}_correlation_s"
            size, of_part = getattr(self, name), getattr(self, part)
            if (of_part is None) != (getattr(self, time) is None):
                raise ValueError(
                    f"has only one of {part} and {time}, which belong together: add the other"
                )
            if of_part is not None and (size is None or of_part > size):
                raise ValueError(
                    f"key {part!r} is a component of {name}: give {name} too, which must be at "
                    "least as large"
                )
        return self

    @model_validator(mode="after")
    def _extra_keys_are_columns(self) -> "Noise":
        stated: dict[str, str] = {}
        for name in self.columns:
            try:
                channel = parse_column(name).name
            except InputError:
                raise ValueError(
                    f"key {name!r} must be {', '.join(NOISE_KEYS)}, a correlated part such as "
                    "position_correlated_m with position_correlation_s, or a column of the run: "
                    "correct or remove it"
                ) from None
            if channel in stated:
                raise ValueError(
                    f"key {name!r} gives the noise of {channel}, and so does {stated[channel]!r}: "
                    "remove one"
                )
            stated[channel] = name
        return self


class Uncertainty(Section):
    """`[uncertainty]`: standard deviations of device parameters and constants, by path.

    Values are in SI, and 0 means exact. A fit frees uncertain parameters with a prior of this
    standard deviation. For those that are not given, the model has usual values.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow", strict=True, frozen=True)
    __pydantic_extra__: dict[str, Deviation | list[Deviation]] = Field(init=False)

    defaults: bool = key(
        "true or false",
        "false: parameters without an entry are exact; true: they have their usual uncertainty",
        default=True,
    )

    @property
    def deviations(self) -> dict[str, float | list[float]]:
        """Standard deviations by path, SI."""
        return dict(self.__pydantic_extra__ or {})

    @model_validator(mode="before")
    @classmethod
    def _deviations_by_path(cls, table: Any) -> Any:
        if not isinstance(table, Mapping):
            return table
        stated = flat(table)
        for path, value in stated.items():
            each = value if isinstance(value, list) and value else [value]
            if path != "defaults" and not all(
                isinstance(one, int | float) and not isinstance(one, bool) and 0 <= one < math.inf
                for one in each
            ):
                raise ValueError(
                    f"key {path!r} is not a standard deviation: give a number of at least 0 in SI "
                    "units (0 for an exact value), or a list of such numbers"
                )
            if (whole := path.partition("[")[0]) != path and whole in stated:
                raise ValueError(
                    f"key {whole!r} applies to all elements, but {path!r} applies to one of them: "
                    "give a list for all elements"
                )
        return stated


class PriorEntry(Section):
    """One entry of `[fit.priors]`: prior knowledge of a parameter."""

    value: Finite = key("a number", "the most probable value, SI", default=...)
    deviation: Positive | None = key("a positive number", "standard deviation, SI")
    factor: Positive | None = key(
        "a number above 1",
        "uncertainty of the value as a factor, up or down; replaces the deviation",
    )

    @model_validator(mode="after")
    def _is_a_prior(self) -> "PriorEntry":
        try:
            self.prior()
        except InputError as error:
            raise ValueError(str(error).removeprefix("the prior ")) from None
        return self

    def prior(self) -> Prior:
        """Return the entry as a prior."""
        return Prior(self.value, self.deviation, self.factor)


NoiseModel = Literal["correlated", "white"]
Loss = Literal["linear", "huber", "soft_l1", "student_t"]

_LOSS = (
    '"linear", "huber", "soft_l1", "student_t", a registered loss, or in a file a table such as '
    '{ name = "student_t", degrees_of_freedom = 4 }'
)


def _known_loss(said: Any) -> Any:
    """Return a loss in the form used in a file; accepts loss objects, too."""
    if not isinstance(said, str | Mapping | type) and hasattr(said, "contents"):
        said = said.contents()
    name = said.get("name") if isinstance(said, Mapping) else said
    known = isinstance(name, str) and (name in get_args(Loss) or registered("loss", name))
    if not known:
        raise ValueError(
            f"= {shown(said)} must be {_LOSS}: correct the name, or give --plugin FILE.py"
        )
    return said


Values = dict[Name, Finite | list[Finite]]
"""Values by parameter path, SI: one for the whole parameter, or one for each element."""


def _known_solver(said: Any) -> Any:
    """Return a solver in the form used in a file; names are checked where the solver is made."""
    text = as_text(said)
    if isinstance(text, str) and "(" in text:
        from_text(text)
    return text


def _known_optimiser(said: Any) -> Any:
    """Return a solver of optimistix after a check of its class, without importing optimistix."""
    if any(each.__name__ == "AbstractLeastSquaresSolver" for each in type(said).__mro__):
        return said
    given = " ".join(shown(said).split())
    raise ValueError(f"= {given} must be {_OPTIMISER}: give one, or omit the key")


_OPTIMISER = (
    "a least-squares solver of optimistix, such as optimistix.LevenbergMarquardt(rtol=1e-8, "
    "atol=1e-8), from Python"
)


class FitSettings(Section):
    """All settings of a fit: `[fit]` of a definition, Python keywords, command-line options.

    Each setting is declared here with its default; `contents` leaves out those that are not set.
    The object is passed on as a whole. `fit_settings` makes it from keywords. The wording of the
    options is in `cli/_fit.py`.
    """

    data: list[Name] = key(
        "a list of file names", "Recorded runs, as paths relative to this file.", default=[]
    )
    free: list[Name] | None = key(
        "a list of parameter paths", "Parameters to fit instead of the default list."
    )
    start: Values = key(
        "a table of parameter paths and numbers", "Start values of parameters.", default={}
    )
    fix: Values = key(
        "a table of parameter paths and numbers", "Hold parameters at these values.", default={}
    )
    priors: dict[Name, PriorEntry] = key(
        "a table of parameter paths, each with a value and a deviation or factor",
        "Priors of parameters; a prior with a factor is log-normal.",
        default={},
        entry="a table such as { value = 1.1, deviation = 0.2 }",
    )
    bounds: dict[Name, Annotated[list[Finite], Field(min_length=2, max_length=2)]] = key(
        "a table of parameter paths and lists of two numbers, [low, high]",
        "Bounds of parameters, within their declared bounds.",
        default={},
        entry="a list of two numbers, [low, high]",
    )
    ties: dict[Name, Name] = key(
        "a table of parameter paths and expressions in quotes",
        'Compute parameters from other parameters, as in "links.mass" = "links.mass[0]".',
        default={},
        entry='an expression in quotes, such as "1.5 * joints.pitch_stiffness"',
    )
    per_run: list[Name] = key(
        "a list of parameter paths",
        "Parameters to fit with a separate value for each run.",
        default=[],
    )
    groups: dict[Name, list[list[Name]]] = key(
        "a table of parameter paths and lists of lists of run names",
        "Parameters to fit with one value for each group of runs.",
        default={},
        entry='a list of lists of run names, such as [["a", "b"], ["c"]]',
    )
    uncertainty: Values = key(
        "a table of parameter paths and positive numbers",
        "Standard deviations of held parameters.",
        default={},
    )
    nuisances: bool = key(
        "true or false",
        "Fit the nuisance parameters, which are always uncertain, with priors; false: hold them "
        "fixed.",
        default=True,
    )
    channels: list[Name] | None = key(
        "a list of channel names, without unit",
        "Fit only these channels, named without unit, such as link20_z.",
    )
    hold_out: list[Name] = key(
        "a list of runs, channels, or last",
        "Data held out from the fit: a run, a channel, or last (the last fifth).",
        default=[],
    )
    window_s: Positive | None = key(
        "a positive number", "Split runs into windows with separate initial states."
    )
    windows_first_s: Positive | None = key(
        "a positive number",
        "First fit windows of this length, then fit the whole runs starting from that result.",
    )
    starts: Annotated[int, Field(ge=1, le=STARTS)] = key(
        f"a whole number from 1 to {STARTS}",
        "Number of starting points; the best result is kept.",
        default=1,
    )
    spread: Positive = key(
        "a positive number",
        "Relative spread of the starting points about the first one; 0.3 is 30 percent.",
        default=0.3,
    )
    seed: Annotated[int, Field(ge=0)] = key(
        "zero or a positive whole number",
        "Seed of the random numbers for the starting points after the first one.",
        default=0,
    )
    validation: list[Name] = key(
        "a list of file names",
        "Runs that are not fitted, but are used to test the predictions of the result.",
        default=[],
    )
    loss: Annotated[Loss | str | dict[str, Any], BeforeValidator(_known_loss)] = key(
        _LOSS,
        "Loss function of the residuals: linear, or huber, soft_l1 or student_t for data with "
        "outliers.",
        default="linear",
    )
    noise_model: NoiseModel = key(
        '"correlated" or "white"',
        "Noise model: correlated (the correlated part of the noise is estimated) or white.",
        default="correlated",
    )
    noise_per_run: bool = key(
        "true or false",
        "Estimate the noise of each run separately (default: of all runs together).",
        default=False,
    )
    solver: Annotated[Name | None, BeforeValidator(_known_solver)] = key(
        "the name of a solver", "Integration method, such as tsit5 (default: springs5)."
    )
    tolerance: Positive | None = key(
        "a positive number",
        "Tolerance of the integration (default: chosen from its effect on the estimates).",
    )
    optimiser: Annotated[Any, Field(exclude=True), BeforeValidator(_known_optimiser)] = key(
        _OPTIMISER,
        "Optimiser to use instead of the trust region of giajax; cannot be given in a file.",
    )
    max_iterations: Annotated[int, Field(ge=1)] = key(
        "a whole number of at least 1", "Maximum number of trial steps of the fit.", default=50
    )
    budget: Annotated[str, Field(pattern=DURATION)] | None = key(
        'a time such as "90s", "10m" or "2h"',
        "Time limit, such as 90s, 10m or 2h, after which the fit returns its best result.",
    )
    out: Name | None = key("the name of a folder", "Folder for the result.")

    @property
    def known(self) -> dict[str, Prior]:
        """Priors by path."""
        return {path: entry.prior() for path, entry in self.priors.items()}

    @property
    def budget_s(self) -> float | None:
        """Time limit of the fit (wall time), s, or None."""
        return None if self.budget is None else seconds_of(self.budget)

    @classmethod
    def shared_with(cls, config: Mapping[str, Any]) -> Self:
        """Return the settings that a later fit of the same runs shares with a result's `config`.

        The uncertain parameters of the earlier fit are among its free parameters, so `nuisances` is
        false.
        """
        names = ("priors", "bounds", "ties", "groups", "loss", "noise_model", "noise_per_run")
        known = {name: config[name] for name in names if name in config}
        try:
            return cls.model_validate({**known, "nuisances": False})
        except ValidationError as error:
            where = ".".join(map(str, error.errors()[0]["loc"]))
            raise InputError(f"the stored fit has no usable {where}: fit its data again") from None

    @field_validator(
        *("start", "fix", "uncertainty", "priors", "bounds", "ties", "groups"), mode="before"
    )
    @classmethod
    def _unquoted_paths_are_paths(cls, table: Any) -> Any:
        # Without quotes, `air.drag_coefficient = 1.2` is a nested table in TOML. Both are accepted.
        leaves = PriorEntry.model_fields
        return flat(table, leaves=leaves) if isinstance(table, Mapping) else table

    @model_validator(mode="after")
    def _windows_or_whole_runs(self) -> Self:
        if self.window_s is not None and self.windows_first_s is not None:
            raise ValueError(
                "has window_s and windows_first_s, but the latter fits whole runs at the end: "
                "remove one"
            )
        return self

    @field_validator("ties")
    @classmethod
    def _ties_are_expressions(cls, ties: dict[str, str]) -> dict[str, str]:
        for path, text in ties.items():
            try:
                Expression.parse(text)
            except InputError as error:
                raise ValueError(f"is not valid for {path}, because {error}") from None
        return ties


FIT_DEFAULTS = {
    name: field.get_default(call_default_factory=True)
    for name, field in FitSettings.model_fields.items()
}


class FitKeywords(TypedDict, total=False):
    """Settings of a fit of given runs as keywords, with arrays and `Prior` objects as values.

    None leaves a setting at its default. `budget` may be a number of seconds.
    """

    free: Sequence[str] | None
    start: Mapping[str, npt.ArrayLike] | None
    fix: Mapping[str, npt.ArrayLike] | None
    priors: Mapping[str, Prior] | None
    bounds: Mapping[str, Sequence[float]] | None
    ties: Mapping[str, str] | None
    per_run: Sequence[str] | None
    groups: Mapping[str, Sequence[Sequence[str]]] | None
    nuisances: bool | None
    loss: Any
    noise_model: str | None
    noise_per_run: bool | None
    solver: Any
    tolerance: float | None
    optimiser: Any
    max_iterations: int | None
    budget: float | str | None


class StartsKeywords(FitKeywords, total=False):
    """Settings of a fit from several initial guesses, as keywords."""

    starts: int | None
    spread: float | None
    seed: int | None


class TaskKeywords(StartsKeywords, total=False):
    """Settings of a fit of files as keywords, including the selected and the held-out data."""

    uncertainty: Mapping[str, npt.ArrayLike] | None
    channels: Sequence[str] | None
    hold_out: Sequence[str] | None
    window_s: float | None
    windows_first_s: float | None


class Figure(Section):
    """One entry of `[figures]`: a value that the fit of a shipped definition must reach."""

    value: Finite | None = key("a number", "expected value")
    standard_errors: Positive | None = key(
        "a positive number",
        "maximum deviation of the fitted value from the expected value, in units of the standard "
        "error",
    )
    relative_error: Positive | None = key(
        "a positive number", "maximum standard error, relative to the fitted value"
    )
    within: Positive | None = key(
        "a positive number",
        "maximum deviation of the fitted value from the expected value, relative to the latter",
    )
    determined: bool | None = key(
        "true or false", "false: the run must not determine the parameter"
    )

    @model_validator(mode="after")
    def _says_one_thing(self) -> "Figure":
        distances = [self.standard_errors, self.within]
        goals = [self.value, *distances, self.relative_error]
        if self.determined is False:
            if any(item is not None for item in goals):
                raise ValueError(
                    "gives determined = false and also a value or an accuracy to reach, but may "
                    "give only one of the two: remove one"
                )
        elif (self.value is None) != (distances == [None, None]) or goals == [None] * 4:
            raise ValueError(
                "must have value and standard_errors (or within), or relative_error, or all: "
                "add the missing keys"
            )
        return self


# The noise of arrays is given by quantity, without the unit that ends the key in a file.
_NOISE_QUANTITIES = {
    key.partition("_")[0]: key for key in Noise.model_fields if "_correlat" not in key
}


def deviation_of(noise: Noise, channel: Channel) -> float | None:
    """Return the standard deviation (SI) that `[noise]` gives for a channel, or None."""
    for column, deviation in noise.columns.items():
        recorded = parse_column(column) if column.startswith(channel.name) else None
        if recorded is not None and recorded.name == channel.name:
            return float(recorded.to_si(deviation))
    key = column_table()[channel.kind].noise
    if key is None or getattr(noise, key) is None:
        return None
    return float(to_si(*_unit_of(key), getattr(noise, key)))


def correlated_part_of(noise: Noise, channel: Channel) -> tuple[float, float] | None:
    """Return standard deviation (SI) and time (s) of the correlated part in `[noise]`, or None."""
    key = column_table()[channel.kind].noise
    # The noise of a quantity does not apply to a column that has its own entry.
    if any(parse_column(column).name == channel.name for column in noise.columns):
        return None
    part = None if key is None else noise.correlated_part(key)
    if key is None or part is None:
        return None
    deviation, time_s = part
    return float(to_si(*_unit_of(key), deviation)), time_s


def _unit_of(key: str) -> tuple[str, str]:
    """Return the quantity and the unit of a key of `[noise]`, which ends with the unit."""
    unit = key.partition("_")[2]
    return QUANTITY_OF_SUFFIX[unit], unit


def noise_section(noise: Mapping[str, float], channels: Mapping[str, Channel]) -> dict[str, Any]:
    """Return the `[noise]` section for standard deviations (SI) by quantity or by channel.

    Raises:
        InputError: a name is neither a quantity nor a channel.
    """
    section: dict[str, Any] = {}
    for name, deviation in noise.items():
        if name in _NOISE_QUANTITIES:
            key = _NOISE_QUANTITIES[name]
            section[key] = float(from_si(*_unit_of(key), deviation))
        elif name in channels:
            section[channels[name].column] = float(channels[name].from_si(deviation))
        else:
            raise InputError(
                f"{name!r} has no noise: give the noise of {', '.join(_NOISE_QUANTITIES)} or of a "
                "channel of the run"
            )
    return section
