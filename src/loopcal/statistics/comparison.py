"""Two calibrations of one machine: do they say the same, and where do they not?

With p_A, p_B the two parameter sets, B first moved to where it agrees best with A at common
poses, d = p_B - p_A has the covariance

    C = C_A + C_B - C_A L C_B - C_B L C_A,   L = diag(1 / prior_sd^2) of the priors both share,

because what both took from the same drawing is no difference. Moving takes away the part of d
that only says where the instrument stood: d' = P d, P = 1 - G (S G)^+ S, with S = dy/dp at the
common poses and G the gauge (`gauge`). The test uses the contrasts K with K^T G = 0, and zero on
everything that either calibration left undetermined:

    chi^2 = (K^T d)^T (K^T C K)^+ (K^T d),   degrees of freedom: the rank of K^T C K

(Rao and Mitra, Generalized Inverse of Matrices and its Applications, 1971, section 9.2). It does
not depend on how the alignment was weighted. Where sds were learnt, C is itself uncertain, and
chi^2 over its degrees of freedom is compared with F (`loopcal.small_samples`).

Where chi-squared rejects the stated sds, C is as large as the residuals. Where the poses of the
calibrations scatter more than C allows (`scatter`), along the contrasts, a difference counts only
if it is one under their own covariance as well, by Hotelling's T^2. That they do is shown at a
level of 25 %, as is usual for a test that chooses between two others (Bancroft and Han 1977): were
any excess enough, chance would take away a fifth to a half of the right alarms.

An error of the machine model moves the parameters otherwise in other poses, by more than any
residual shows. Two calibrations in different regions are compared by what each says of the region
that it has not seen. Unless learnt terms carry the error of both models, a difference beyond the
noise then decides nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.chi_squared import tail
from loopcal.document.verdict import Fact, Where, fact
from loopcal.errors import InputError
from loopcal.estimation.prediction import predict_outputs, solving
from loopcal.estimation.problem.alignment import align
from loopcal.estimation.problem.constants import with_implied, with_latest
from loopcal.estimation.result import FitResult
from loopcal.estimation.sensitivity import output_sensitivity
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.small_samples import LearntCovariance, contrasts, f_limit
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.compared import (
    SIGNIFICANT,
    Compared,
    ContrastTest,
    ParameterDifference,
    PointDifference,
)
from loopcal.statistics.gauge import carried, changes, difference, gauge, moved, values_of
from loopcal.statistics.lens_fields import LensField, apart

# Chosen, not derived: covariances of poses by pairs; time and memory.
MOST_POSES = 500
"""Common poses from each calibration, evenly thinned."""
# Record 0066: Bancroft and Han (1977).
_CHOOSES = 0.25
"""p-value below which the poses scatter more than the sds allow."""


def compare(
    a: FitResult | Calibrated,
    b: FitResult | Calibrated,
    *,
    poses: Dataset | None = None,
    align: bool = True,
) -> Compared:
    """What differs between two calibrations of one machine, and whether that means anything.

    poses: readings [SI] of the quantities that are not outputs, where the machines are compared;
    by default those of both calibrations. align: B is first moved to where it agrees best with
    A, as another place of the instrument demands; False: both stand in the same frame.

    Raises InputError where the two are not the same machine, or no poses are known.
    """
    a = Calibrated.of(a, "A") if isinstance(a, FitResult) else a
    b = Calibrated.of(b, "B") if isinstance(b, FitResult) else b
    stood, (a, b) = (a, b), (_unstationed(a), _unstationed(b))
    _check_same(a.mechanism, b.mechanism)
    aligned = align and a.mechanism.placement is not None and len(a.mechanism.outputs) in (2, 3)
    points = _points(*stood, a, poses) if a.mechanism.outputs else None
    if aligned and points is not None:
        b, motion = _brought(b, points)
        points = replace(points, b=motion @ np.vstack([points.b, np.ones((1, points.b.shape[1]))]))
        G = gauge(a.mechanism, values_of(a.mechanism), points.a.mean(axis=1))
    else:
        aligned, G = False, np.zeros((len(a.nominal), 0))
    d = difference(a.mechanism, values_of(a.mechanism), values_of(b.mechanism))
    a, b = a.with_offsets, b.with_offsets
    loose = np.hstack([a.undetermined, b.undetermined])
    P = np.eye(len(d))
    if G.shape[1] and points is not None:
        stacked = points.S.reshape(-1, len(d))
        P = P - G @ np.linalg.lstsq(stacked @ G, stacked, rcond=None)[0]
    # Prints wear and warp; the machine is the rest.
    of_points = np.isin(a.mechanism.parameters.names, a.mechanism.parameters.of_role("corner"))
    left_out = np.hstack([G, loose, np.eye(len(d))[:, of_points]])
    C = covariance_between(a, b)
    tested = _statistic(d, C, left_out)
    scattered = None
    if (tested.p_value or 0.0) < SIGNIFICANT:
        scattered = _by_scatter(a, b, d, C, left_out)
    if scattered is not None and (scattered.test.p_value or 0.0) > (tested.p_value or 0.0):
        C, tested = scattered.covariance, scattered.test
    else:
        scattered = None
    spread = C.through(P)
    pixels = {a.mechanism.quantities[q] for q in a.mechanism.outputs} == {"px"}
    unit = "px" if pixels else "m"
    return Compared(
        a.name,
        b.name,
        aligned,
        _parameters(a, b, d, spread, P @ loose),
        None if points is None else _differences(points, spread, points.S @ (P @ loose), unit),
        tested,
        _reaches(a, b),
        tuple(_remarks(a, b, aligned, scattered)),
    )


@dataclass(frozen=True)
class _Points:
    """Predicted points (o, N) of both machines at common poses, and S (N, o, n_all) of A, as it
    is compared."""

    a: Array
    b: Array
    S: Array
    ids: tuple[str, ...]


def _check_same(a: Mechanism, b: Mechanism) -> None:
    if a.parameters.names != b.parameters.names or a.outputs != b.outputs:
        only_a = [n for n in a.parameters.names if n not in b.parameters.names]
        only_b = [n for n in b.parameters.names if n not in a.parameters.names]
        words = f": only A has {', '.join(only_a) or 'none'}, only B {', '.join(only_b) or 'none'}"
        raise InputError(
            f"the two calibrations do not describe the same machine{words}",
            code="conflicting-keys",
            remedy="compare results of one mechanism, with the same parameters and outputs",
        )


def _unstationed(one: Calibrated) -> Calibrated:
    """An updated arm of transitions, its geometry where it stands: as others describe it."""
    from loopcal.mechanisms.station import unstationed

    before, made = one.mechanism, unstationed(one.mechanism)
    if made is before:
        return one
    names = before.parameters.names

    def values(p: Array) -> Array:
        return values_of(
            unstationed(before.with_nominal(dict(zip(names, p.tolist(), strict=True))))
        )

    M = changes(made, values, values_of(before))
    kept = [names.index(name) for name in made.parameters.names]
    nominal, prior_sd = one.nominal[kept], one.prior_sd[kept]
    return replace(one.through(made, M), nominal=nominal, prior_sd=prior_sd)


def _points(
    a: Calibrated, b: Calibrated, compared: Calibrated, poses: Dataset | None
) -> _Points | None:
    sets = [poses] if poses is not None else [c.poses for c in (a, b) if c.poses is not None]
    if not sets:
        raise InputError(
            "the two calibrations have no common poses to compare at",
            code="mismatched-poses",
            remedy="give poses with readings of the joints",
        )
    if len(sets) == 2 and _alike(*sets):
        sets = sets[:1]  # two calibrations from the same readings
    chosen = sets if poses is not None else [thinned(s) for s in sets]
    y_a, y_b = (np.hstack([_predicted(c, s) for s in chosen]) for c in (a, b))
    predicted = np.isfinite(y_a).all(axis=0) & np.isfinite(y_b).all(axis=0)
    if not predicted.any():
        return None
    S = np.concatenate([sensitivity(compared, s) for s in chosen])
    ids = tuple(i for s in chosen for i in s.poses)
    kept = np.flatnonzero(predicted)
    return _Points(y_a[:, kept], y_b[:, kept], S[kept], tuple(ids[i] for i in kept))


def _alike(a: Dataset, b: Dataset) -> bool:
    """Whether two sets hold the same readings of the same poses."""
    return (
        a.poses == b.poses
        and a.quantities == b.quantities
        and all(np.array_equal(a[q], b[q], equal_nan=True) for q in a.quantities)
    )


def thinned(data: Dataset) -> Dataset:
    """At most `MOST_POSES` of the poses."""
    return data.take(slice(None, None, -(-len(data) // MOST_POSES)))


def _readings(one: Calibrated, machine: Mechanism, data: Dataset) -> tuple[Array, Array]:
    """x (k, N) and constants (c, N); what is solved for starts where it usually is."""
    data = with_implied(machine, with_latest(machine, data))
    rows = []
    for q in machine.tape.quantities:
        column = data.readings.get(q, np.full(len(data), np.nan))
        solved = q in machine.outputs or q not in data.readings
        rows.append(
            np.where(np.isnan(column), one.hidden.get(q, 0.0), column) if solved else column
        )
    lacking = [
        q
        for q in (*machine.tape.quantities, *machine.tape.pose_constants)
        if q not in data.readings and q not in {*machine.outputs, *machine.disturbances}
        if q not in machine.unused
    ]
    if lacking:
        raise InputError(
            f"the common poses have no readings of {', '.join(map(repr, lacking))}",
            code="missing-reading",
            remedy="give poses with a column for each quantity that is not an output",
        )
    nothing = np.zeros(len(data))
    constants = np.array([data.readings.get(q, nothing) for q in machine.tape.pose_constants])
    return np.array(rows), constants.reshape(-1, len(data))


def _predicted(one: Calibrated, data: Dataset) -> Array:
    machine = solving(one.mechanism, one.hidden)
    x, constants = _readings(one, machine, data)
    return predict_outputs(machine, values_of(machine), x, constants)[: len(one.mechanism.outputs)]


def sensitivity(one: Calibrated, data: Dataset) -> Array:
    """(N, o, n_all) of the outputs at readings [SI] of what is no output; NaN where lost."""
    machine = solving(one.mechanism, one.hidden)
    x, constants = _readings(one, machine, data)
    values, rows = values_of(machine), [machine.tape.quantities.index(q) for q in machine.outputs]
    x[rows] = predict_outputs(machine, values, x, constants)
    S = output_sensitivity(machine, values, machine.parameters.names, x, constants).by_parameter
    return S[:, : len(one.mechanism.outputs)]


def _brought(b: Calibrated, points: _Points) -> tuple[Calibrated, Array]:
    """B moved to A, and the motion as a matrix (o, o + 1)."""
    motion = align(points.b, points.a)
    machine, values = b.mechanism, values_of(b.mechanism)
    M = carried(machine, values, motion.rotation, motion.shift)
    new = moved(machine, values, motion.rotation, motion.shift)
    named = dict(zip(machine.parameters.names, new.tolist(), strict=True))
    brought = b.through(machine.with_nominal(named), M)
    return brought, np.column_stack([motion.rotation, motion.shift])


def covariance_between(
    a: Calibrated, b: Calibrated, learnt: Sequence[LensField] = ()
) -> LearntCovariance:
    """Of p_B - p_A, as large as the residuals; what a lens leaves is one field in both.

    learnt: what lenses leave, where more images than those of either say so.
    """
    covariance = _between(*(one.without_fields.by_residuals for one in (a, b)))
    # The last slopes are of these parts: without them what is tested seems hardly known.
    parts = [one.factor * one.pose_part for one in (a, b) if one.pose_part is not None]
    covariance = replace(covariance, plain=sum(parts, covariance.plain))
    fields = learnt or (*a.fields, *b.fields)
    return covariance.widened(apart(a.fields, b.fields, len(a.nominal), fields))


def _between(a: Calibrated, b: Calibrated) -> LearntCovariance:
    """Of p_B - p_A; a prior that both share counts once.

    Offsets of the points of a print have a prior sd that each has learnt, and are the same in both.
    """
    same = np.isfinite(a.prior_sd) & (a.prior_sd == b.prior_sd) & (a.prior_sd > 0.0)
    if a.offsets is not None and b.offsets is not None:
        same |= np.isfinite(a.offsets.prior_sd) & np.isfinite(b.offsets.prior_sd)
    # A prior is shared only if both began at the same drawing.
    close = np.abs(a.nominal - b.nominal) <= 1e-6 * np.where(same, a.prior_sd, 1.0)
    product = np.where(same, a.prior_sd, 1.0) * np.where(same, b.prior_sd, 1.0)
    precision = np.where(same & close, 1.0 / product, 0.0)

    def shared(one: Array, other: Array) -> Array:
        """What both, or its slopes, took from the drawing."""
        half = one @ (precision[:, None] * other)
        return half + np.swapaxes(half, -1, -2)

    A, B = a.covariance, b.covariance
    # by what the prior weighed in the fit, however large the covariance has become since
    G, H = a.unwidened, b.unwidened
    common = shared(G, H)
    return LearntCovariance(
        A.matrix + B.matrix - common,
        A.plain + B.plain - common,
        np.concatenate([A.slopes - shared(A.slopes, H), B.slopes - shared(B.slopes, G)]),
    )


def _reaches(a: Calibrated, b: Calibrated) -> float | None:
    """How many times less certain one is at the poses of the other than at its own.

    None where it does not matter: both models carry their error, or the poses are not known.
    """
    if (a.carried and b.carried) or a.poses is None or b.poses is None or not a.mechanism.outputs:
        return None
    ratios = []
    for one, same, other in ((a, a.poses, b.poses), (b, b.poses, a.poses)):
        size_at_other, size_at_same = (_size(one, thinned(poses)) for poses in (other, same))
        ratios.append(size_at_other / size_at_same if size_at_same > 0.0 else 1.0)
    return max(ratios)


def _size(one: Calibrated, poses: Dataset) -> float:
    """Rms over poses of the sd that parameters cause at the end point."""
    S = sensitivity(one, poses)
    variances = np.einsum("noo->n", one.covariance.through(S[np.isfinite(S).all((1, 2))]).plain)
    return float(np.sqrt(variances.mean())) if len(variances) else 0.0


@dataclass(frozen=True, eq=False)
class _ByScatter:
    """Covariance of d by the scatter of the poses, the test by it, and how many times as large as
    the other it is along the contrasts."""

    covariance: LearntCovariance
    test: ContrastTest
    ratio: float


def _by_scatter(
    a: Calibrated, b: Calibrated, d: Array, C: LearntCovariance, left_out: Array
) -> _ByScatter | None:
    """The test by the scatter of the poses; None where that does not show to be larger than C."""
    freedom = sum(one.scatter.freedom for one in (a, b) if one.scatter is not None)
    seen = _between(a.by_scatter, b.by_scatter)
    K = contrasts(C, left_out)
    size = len(K)
    ratio = float(np.trace(seen.through(K).matrix)) / size if size else 0.0
    denominator = freedom - size + 1.0
    # In units of C each of q contrasts scatters as a chi-squared with nu degrees of freedom.
    if denominator < 1.0 or tail(freedom * size * ratio, freedom * size) >= _CHOOSES:
        return None
    # T^2 (nu - q + 1) / (nu q) follows F(q, nu - q + 1) (Hotelling 1931).
    square = _statistic(d, seen, left_out).value * denominator / freedom
    return _ByScatter(seen, ContrastTest(square, size, denominator), ratio)


def _statistic(d: Array, C: LearntCovariance, left_out: Array) -> ContrastTest:
    """The test of the contrasts that feel nothing of these directions."""
    K = contrasts(C, left_out)
    denominator = float(C.through(K).denominator)
    return ContrastTest(float(np.square(K @ d).sum()), len(K), denominator)


def _parameters(
    a: Calibrated, b: Calibrated, d: Array, spread: LearntCovariance, loose: Array
) -> tuple[ParameterDifference, ...]:
    sds, freedom = np.sqrt(np.maximum(np.diag(spread.matrix), 0.0)), spread.freedom.tolist()
    size = np.abs(loose).max(axis=1, initial=0.0)
    unknown = size > 1e-6 * size.max(initial=0.0)
    stands = () if a.mechanism.placement is None else a.mechanism.placement.parameters
    differences = []
    for i, parameter in enumerate(a.mechanism.parameters):
        value, change = parameter.nominal, float(d[i])
        sd = None if unknown[i] else float(sds[i])
        z = change / sd if sd else None
        name, unit = parameter.name, parameter.unit
        degrees = freedom[i] if sd and math.isfinite(freedom[i]) else None
        differences.append(
            ParameterDifference(
                name, unit, value, value + change, change, sd, z, name in stands, degrees
            )
        )
    return tuple(differences)


def _differences(
    points: _Points, spread: LearntCovariance, loose: Array, unit: str
) -> PointDifference:
    delta = (points.b - points.a).T
    covariance = spread.through(points.S)
    inverse = np.linalg.pinv(covariance.matrix, rcond=1e-9, hermitian=True)
    square = np.einsum("no,nop,np->n", delta, inverse, delta)
    within = square <= f_limit(1.0 - SIGNIFICANT, delta.shape[1], covariance.denominator)
    size = np.abs(points.S).max() * np.abs(loose).max(initial=0.0)
    if size:  # without any bound
        within = within | (np.abs(loose).max(axis=(1, 2), initial=0.0) > 1e-9 * size)
    return PointDifference.of(points.ids, delta, covariance.matrix, within, unit)


def _remarks(
    a: Calibrated, b: Calibrated, aligned: bool, scattered: _ByScatter | None
) -> Iterator[Fact]:
    if scattered is not None:
        yield fact("poses-scatter", numbers={"times": math.sqrt(scattered.ratio)})
    if not aligned:
        yield fact("not-aligned")
    if _share_readings(a, b):
        yield fact("same-readings")
    for one in (a, b):
        if one.factor > 1.0:
            numbers = {"times": math.sqrt(one.factor)}
            yield fact("sds-rejected", Where(files=(one.name,)), numbers)


def _share_readings(a: Calibrated, b: Calibrated) -> bool:
    if a.data is None or a.data != b.data:
        return False
    if a.poses is None or b.poses is None:
        return True
    return bool(set(a.poses.poses) & set(b.poses.poses))
