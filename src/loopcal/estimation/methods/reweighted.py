"""Reweighted least squares: the open loops, weighted by the noise of their readings."""

from loopcal.estimation.methods.method import Method
from loopcal.estimation.problem.problem import Weighting
from loopcal.estimation.solve.reweighted import solve_reweighted

METHOD = Method(
    name="reweighted",
    label="reweighted least squares (readings weighted by their propagated noise)",
    description="Reweighted least squares: the open loops, weighted by the noise that the "
    "readings bring into them.",
    solve=solve_reweighted,
    weighting=Weighting.READ,
    likelihood=False,
    robust=True,
)
