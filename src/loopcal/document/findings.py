"""What the equations of a calibration say beyond its parameters: poses, directions, outliers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from loopcal.document.plain import Count, Probability, Size
from loopcal.presentation.shown import significant, with_unit


@dataclass(frozen=True)
class Undetermined:
    """A direction in which neither data nor prior say anything."""

    combination: Mapping[str, float]
    """Parameter -> its share, the largest 1."""
    words: str

    @classmethod
    def of(cls, combination: Mapping[str, float]) -> Undetermined:
        """The direction, in words too."""
        names = [repr(name) for name in combination]
        listed = ", ".join(names[:-1]) + f" and {names[-1]}"
        words = (
            f"{names[0]} has no effect in these poses"
            if len(names) == 1
            else f"{listed} cannot be distinguished by these poses"
        )
        return cls(dict(combination), words)


@dataclass(frozen=True)
class CheckEntry:
    """Whether the readings of an update are of the machine that was calibrated; null: open."""

    passed: bool | None
    words: str
    """What differs."""


@dataclass(frozen=True)
class Learned:
    """A parameter that had a prior: what the data added to it."""

    parameter: str
    ratio: Size
    """Its sd over its prior sd; near 1: the value is the drawing's, not the data's."""
    words: str


@dataclass(frozen=True)
class WeakDirection:
    """A combination of parameters that these poses hardly distinguish, or not at all."""

    combination: Mapping[str, float]
    """Leading parameters -> share in scaled units, the largest 1."""
    one_sd: Mapping[str, float]
    """The same -> change [SI] that the data allow within one sd; empty: any."""
    condition: Size | None
    """Largest singular value over that of this direction; null: not determined."""
    words: str
    size: Size | None = None
    """Of the direction that changes the size of the machine, all lengths alike: the share of it
    that the data allow within one sd; null: another direction."""


@dataclass(frozen=True)
class CalibrationIndex:
    """C = sum over poses of (S - M), S the quantities sensed, M the mobility of the mechanism.

    With k quantities and m independent loop equations a pose has the mobility M = k - m; with u
    of the quantities unmeasured it senses S = k - u; so it yields S - M = m - u equations.
    Hollerbach and Wampler (1996).
    """

    value: int
    """Sensed minus mobility: equations that the poses give."""
    sensed: Count
    mobility: int
    poses: Count | None = None
    """How many poses; null: written by an earlier version."""
    parameters: Count | None = None
    """How many are estimated; null: written by an earlier version."""

    def words(self) -> str:
        """One line."""
        return (
            f"calibration index {self.value} (sensed {self.sensed} - mobility {self.mobility}, "
            f"over {self.poses} poses) for {self.parameters} parameters"
        )


@dataclass(frozen=True)
class Identifiability:
    """What these poses determine. The last four are null where they were not computed."""

    rank: Count
    """Directions determined by data and prior together."""
    parameters: Count
    """Number of estimated parameters."""
    data_rank: Count
    """Directions determined by the data alone."""
    condition_number: Size | None
    """Largest over smallest singular value of the column-scaled whitened parameter Jacobian; null
    where it is singular."""
    not_identifiable: tuple[Undetermined, ...]
    data_condition_number: Size | None = None
    """The same without the prior; null where singular."""
    data_versus_prior: tuple[Learned, ...] | None = None
    """What the data added to the prior."""
    weak_directions: tuple[WeakDirection, ...] | None = None
    """By the data alone, the worst first."""
    calibration_index: CalibrationIndex | None = None

    @property
    def loose(self) -> frozenset[str]:
        """The parameters that take part in a direction that is not determined."""
        return frozenset(name for u in self.not_identifiable for name in u.combination)

    def warnings(self) -> tuple[str, ...]:
        """One sentence that names all of these directions, and the remedy."""
        if not self.not_identifiable:
            return ()
        directions = "; ".join(loose.words for loose in self.not_identifiable)
        return (
            f"Not identifiable: {directions}. The fit keeps such a combination near its "
            "start; fix a parameter, give it a prior sd, or measure other poses.",
        )


@dataclass(frozen=True)
class ScaleEntry:
    """By how much one scale differs from another, relative to it; or a distance too long."""

    instruments: tuple[str, ...]
    """Those of a station, beside the first station; none: all of them beside the drawing."""
    size: float
    sd: Size
    p_value: Probability
    """Of a difference at least so large where there is none."""
    moves: Size
    """Rms distance [m] by which it moves the measured points about their mean."""
    unit: str = "1"
    """"m" of a distance that an instrument reads too long: size and sd are in m then."""
    joint: str = ""
    """Whose true angles are 1 + size times what is read; moves is in rad then."""


@dataclass(frozen=True)
class DelayEntry:
    """What was read of the machine is a share of the way to a neighbour off, alike in all poses;
    below zero what was read by the instrument is."""

    ahead: bool
    """Whether towards the next pose, not towards the last one."""
    share: float
    """Of the way to that pose."""
    sd: Size
    p_value: Probability
    """Of a share at least so large where there is none."""

    def words(self, sure: str = "") -> str:
        """Whose readings are from when; sure: behind the share."""
        share = f"{significant(100.0 * abs(self.share), 2)} %{sure} of the way"
        moment = (
            f"after each pose is left: {share} to the next one is done"
            if self.ahead
            else f"before each pose is reached: {share} from the last one is left"
        )
        whose = "machine's" if self.share > 0.0 else "instrument's"
        return f"the {whose} readings are from {moment}"


@dataclass(frozen=True)
class JointErrorEntry:
    """An error of the machine that no term explains, and that follows one of its joints."""

    joint: str
    parameter: str
    """As if this one changed with the joint."""
    low: float
    high: float
    """Of the joint in the measured poses [SI]."""
    share: float
    """Of the squares that the fit leaves, which such a change would explain."""
    p_value: Probability
    """Of a share at least so large in independent errors, corrected for the search."""


@dataclass(frozen=True)
class ConflictEntry:
    """An observation beside all others, and by itself."""

    instrument: str
    beside: Size
    """Rms of what its readings leave in the fit of all [unit]."""
    alone: Size
    """Rms of what they would leave if nothing else had been observed [unit], without what they then
    determine by chance."""
    unit: str
    p_value: Probability
    """Of a contradiction at least so large where there is none."""

    @property
    def apart(self) -> float:
        """By how much it contradicts the others, rms [unit]."""
        return float(max(self.beside**2 - self.alone**2, 0.0) ** 0.5)


@dataclass(frozen=True)
class RepeatsEntry:
    """Repeats of a pose beside different poses, in a fit that counts each row as independent."""

    rows: Count
    """That repeat a pose, the first reading of each pose left out."""
    ratio: Size
    """Rms of what poses leave, over that of repeats about the mean of their pose."""
    p_value: Probability
    """Of a ratio at least so large where errors are independent (lack of fit)."""


@dataclass(frozen=True)
class Observability:
    """The observability indices of N poses, without unit; larger is better.

    sigma_1 >= ... >= sigma_n are the singular values of the column-scaled, whitened Jacobian.
    Columns have the length 1, so that sigma_1^2 + ... + sigma_n^2 = n whatever N is; N enters O1
    alone, which therefore compares sets of equally many poses only. All are zero where a direction
    is not determined.
    """

    O1: Size
    """(sigma_1 ... sigma_n)^(1/n) / sqrt(N). Borm and Menq (1991)."""
    O2: Size
    """sigma_n / sigma_1, the inverse condition number. Driels and Pathre (1990)."""
    O3: Size
    """sigma_n. Nahvi, Hollerbach and Hayward (1994)."""
    O4: Size
    """sigma_n^2 / sigma_1. Nahvi and Hollerbach (1996)."""
    O5: Size
    """1 / (1/sigma_1 + ... + 1/sigma_n). Sun and Hollerbach (2008)."""

    def words(self) -> str:
        """One line."""
        numbers = ", ".join(f"{k} {significant(v, 3)}" for k, v in asdict(self).items())
        return f"observability {numbers}"


@dataclass(frozen=True)
class UsualSd:
    """The sd that the parameters cause in one instrument's outputs of one unit."""

    instrument: str
    station: str | None
    unit: str
    sd: Size
    """Root of the trace of their covariance, not exceeded at 95 % of the calibration poses."""
    residual: Size | None = None
    """Of a method that takes readings as exact: the sd of one of these outputs that its residuals
    show, beside what an image shares; null: the sds of the readings say it."""


@dataclass(frozen=True)
class HalvesEntry:
    """A parameter of a lens by two halves of the images that were fitted apart."""

    name: str
    unit: str
    first: float
    second: float
    sd: Size
    """Of the difference [unit]."""
    degrees_of_freedom: Size | None
    """Of Student's t of the difference; null: its sd is known."""

    @property
    def sds(self) -> float:
        """The difference over its sd."""
        return (self.second - self.first) / self.sd


@dataclass(frozen=True)
class LensErrorEntry:
    """What the lens of a camera leaves over its image, alike in all images."""

    camera: str
    rms: Size
    """Of u or v [px], where corners were read."""
    gain: float
    """By how much it lowers -2 log of the restricted likelihood."""
    image: tuple[float, float] = (0.0, 0.0)
    """Width and height that the waves span [px]."""
    spectrum: tuple[float, ...] = ()
    """Variance of each wave [px squared], of u and then of v."""
    moved: tuple[tuple[float, ...], ...] = ()
    """How far 1 px of each wave moves each estimated parameter [SI], by parameter and wave; empty:
    written by an earlier version."""


@dataclass(frozen=True)
class RegionRange:
    """Range of a reading in the working region [SI]."""

    quantity: str
    low: float
    high: float
    source: str
    """stated; limits: of the joint; turn: nobody states limits, so a quarter turn either way
    of the middle of the readings, or as far as these go; readings: as far as these go."""


@dataclass(frozen=True)
class RegionSd:
    """The predicted sd in the working region, beside that at the measured poses.

    That of `loopcal predict`: of what parameters and readings cause.
    """

    unit: str
    sd_at_poses: Size
    """Rms over the measured poses, root of the trace over the outputs."""
    sd: Size | None
    """Rms over the region; null: unbounded, the data leave a direction open."""
    ratio: Size | None
    """Of the two."""
    instrument: str | None = None
    """Whose readings are predicted, where there are several."""
    sd_at_bounds: Size | None = None
    """As `sd_at_poses`, were each sd of a reading that may be 0 at its upper bound; null:
    none was, or one has no bound."""

    @property
    def seen(self) -> str:
        """By which instrument, in words; empty where there is one."""
        return f" as {self.instrument!r} sees it" if self.instrument else ""


@dataclass(frozen=True)
class RegionEntry:
    """The working region, and how sure the calibration is there."""

    ranges: tuple[RegionRange, ...]
    by: tuple[RegionSd, ...]
    """For each unit of outputs that of the instrument with the largest ratio; the worst first. What
    cameras see has two: px, and m at the board."""
    parked: tuple[str, ...] = ()
    """Joints that stood still in all poses and have room in the region."""
    while_parked: tuple[RegionSd, ...] = ()
    """As `by`, where these joints stay as they stood."""

    @property
    def worst(self) -> RegionSd:
        """The largest ratio of any unit; what is stated in px is stated in m as well."""
        return self._worst(self.by)

    @property
    def worst_while_parked(self) -> RegionSd | None:
        """The same where parked joints stay; None without any."""
        return self._worst(self.while_parked) if self.while_parked else None

    @staticmethod
    def _worst(by: tuple[RegionSd, ...]) -> RegionSd:
        return next((one for one in by if one.unit != "px"), by[0])

    def of(self, unit: str) -> RegionSd | None:
        """Of one unit; None where no output has it."""
        return next((one for one in self.by if one.unit == unit), None)


@dataclass(frozen=True)
class SmoothErrors:
    """Errors of the poses that a robot states, alike in poses near each other: what predictions of
    poses far from those of the fit need beside `pose_part`."""

    poses: tuple[tuple[float, ...], ...]
    """Of the fit, some of them where there are many: x, y, z [m], qw, qx, qy, qz."""
    mean_squares: tuple[float, float]
    """Of distance [m squared] and of turn, over all pairs of poses of the fit."""
    lengths: tuple[float, ...]
    """Over which errors are alike; a distance or turn of 1 is the root of its mean square."""
    sizes: tuple[float, ...]
    """Of each length the variance, in units of the learnt ones."""
    alone: float
    """The variance that each pose has by itself."""
    variances: tuple[float, ...]
    """Of errors of x, y, z, wx, wy, wz [SI squared], less those of the learnt sds."""
    spread: Size
    """Relative sd of the smooth variance."""


@dataclass(frozen=True)
class PrintedEntry:
    """Offsets d of the points of prints, which the fit eliminated. With the error dp of the
    estimated parameters they err by F dp + U w + V v, all w and v independent of sd 1."""

    names: tuple[str, ...]
    sds: tuple[float, ...]
    """[m], of U w + V v."""
    follow: tuple[tuple[float, ...], ...]
    """F, by offset and parameter [SI]."""
    together: tuple[tuple[float, ...], ...]
    """U^T [m], by what all points share and by offset."""
    alone: tuple[tuple[float, ...], ...]
    """V [m], by offset and the three v of its point."""
    prior: tuple[float, ...]
    """Learnt sds of the offsets themselves [m]."""


@dataclass(frozen=True)
class FurtherWavesEntry:
    """Waves of the joints that the discrepancy of a body leaves out."""

    body: str
    """"" for the only one."""
    sd: Size
    """Of the amplitudes [m]."""
    moved: tuple[tuple[float, ...], ...]
    """What an amplitude of one sd does to each estimated parameter [SI], by parameter and wave."""


@dataclass(frozen=True)
class PredictionEntry:
    """What `loopcal predict` needs beside the covariance and the calibrated mechanism."""

    sd_at_poses: Mapping[str, Size]
    """SI unit of outputs -> the largest of `by`."""
    typical: Mapping[str, float]
    """Quantity -> median reading [SI]."""
    covariance: tuple[tuple[float, ...], ...] | None
    """Of the estimated parameters over the determined directions; null: the `covariance` of
    the result, less its `pose_part`."""
    undetermined: tuple[tuple[float, ...], ...]
    """Parameter steps [SI] that neither data nor prior limit."""
    by: tuple[UsualSd, ...] = ()
    """Per instrument; empty: written by an earlier version, which took all outputs together."""
    unmeasured: tuple[str, ...] = ()
    """Quantities that no sensor read: a column of one holds start values only."""
    region: RegionEntry | None = None
    """The working region; null: not known, or written by an earlier version."""
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Temperature, load or another known column -> least and largest value [SI] in the poses."""
    shared: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Output -> what each of the independent errors, of one sd, that all outputs of an image share
    does to it, beside `residual`; empty: the outputs err by themselves."""
    smooth_errors: SmoothErrors | None = None
    """Of stated poses; null: none that are learnt, or written by an earlier version."""
    seen: Mapping[str, float] = field(default_factory=dict)
    """Camera -> the largest angle [rad] from the axis of its lens at which a corner was read."""
    printed: PrintedEntry | None = None
    """Null: no print whose points may be off, or written by an earlier version."""
    further_waves: tuple[FurtherWavesEntry, ...] = ()
    """Empty: none are seen, or written by an earlier version."""


@dataclass(frozen=True)
class Outlier:
    """One pose that does not fit the others."""

    pose: str
    quantity: str | None
    """The reading to blame; null where no single one explains the pose."""
    statistic: float | None
    """Normal deviate of the reading, chi-squared of the pose where quantity is null; null: beyond
    all bounds."""
    p_value: Probability
    """Of one at least so large in good data."""
    pose_statistic: float | None
    """Chi-squared of the pose; null: beyond all bounds."""
    size: float | None
    """Reading minus its true value as the rest of the data has it [unit]."""
    unit: str | None
    indistinct: tuple[str, ...] = ()
    """Readings that would explain the pose as well."""
    cause: str | None = None
    """What probably happened."""
    verified: bool = False
    """Whether correcting it made the pose unremarkable."""
    instrument: str | None = None
    """The instrument that read `quantity`; null: a joint, or written by an earlier version."""
    together: tuple[str, ...] = ()
    """Where quantity is null: the instruments whose readings together explain the pose, and "the
    joints"; several: these readings cannot distinguish them. Of one point, size is how far off."""

    @property
    def blamed(self) -> str:
        """What is to blame, in words."""
        if self.quantity is not None:
            of = f" ({self.instrument})" if self.instrument else ""
            return self.quantity + of
        if not self.together:
            return "the whole pose"
        if self.size is not None:
            return f"the point of {self.together[0]!r}"
        instruments = [repr(who) for who in self.together if who != "the joints"]
        named = [*instruments, *(["the joints"] if "the joints" in self.together else [])]
        return f"several readings of {' or of '.join(named)}"

    def __str__(self) -> str:
        who = "no single reading or instrument explains it"
        if self.size is not None and self.unit is not None:
            who = f"{self.blamed} is off by {with_unit(self.size, self.unit)}"
            if self.indistinct:
                who += f" (or else {', '.join(self.indistinct)})"
        elif self.together:
            who = f"{self.blamed} are off"
        text = f"pose {self.pose}: {who}, "
        text += "inf" if self.statistic is None else significant(abs(self.statistic), 3)
        text += " sds" if self.quantity is not None else " chi-squared"
        if self.cause:
            text += f"; {self.cause}" + (" (tried: it then fits)" if self.verified else "")
        return text


@dataclass(frozen=True)
class OutlierTests:
    """How poses and readings were tested."""

    level: Probability
    """Of naming anything where every reading is good."""
    poses: Count
    """Poses that could be tested."""
    scale: Size
    """Factor on the stated sds that the tests used."""
    by_residuals: bool
    """Whether that factor comes from the residuals."""


@dataclass(frozen=True)
class ColumnFault:
    """A fault of whole columns, of the order of rows, or of the whole file.

    Misfit: the rms distance [`unit`] of the nine tenths of the poses where the nominal machine is
    nearest to the readings, with instruments and targets placed as well as can be.
    """

    quantities: tuple[str, ...]
    words: str
    """What it is; alternatives that the readings cannot distinguish are joined by "or"."""
    before: Size | None
    """Misfit [`unit`] as read; null: no loop closes."""
    after: Size | None
    """The same with the fault corrected; null: the readings do not say how."""
    placed: bool = True
    """Whether the machine can be placed."""
    code: str = "column"
    """left-handed, reversed, unit, exchanged, orientation, pose-inverted, rows-shifted,
    rows-shuffled, constant or wrong-machine; column: written by an earlier version."""
    unit: str = "m"
    """Of both misfits, SI; "1": a plain number."""

    def __str__(self) -> str:
        if self.after is None:
            return self.words
        meets = "the nominal machine meets the readings" if self.placed else "the loops fit"
        unit = f" {self.unit}" if self.unit != "1" else ""
        before = "inf" if self.before is None else f"{self.before:.3g}"
        return (
            f"{self.words}: once corrected, {meets} to {self.after:.3g}{unit} rms instead of "
            f"{before}{unit}"
        )


@dataclass(frozen=True)
class OtherOptimum:
    """Another optimum of the same readings."""

    parameters: Mapping[str, float]
    """Those that differ [SI]."""
    chi_squared: float
    words: str
    of_result: float | None = None
    """chi_squared of the result; null: written by an earlier version."""

    def __str__(self) -> str:
        return self.words
