"""The implicit loop: every sensor is uncertain, readings are corrected until the loops close."""

from loopcal.estimation.methods.method import Method
from loopcal.estimation.solve.solver import solve

METHOD = Method(
    name="implicit-loop",
    label="implicit loop (all sensors uncertain)",
    description="Implicit loop: every sensor is uncertain. Readings are corrected until all "
    "loops close, with the least squares of corrections over their sds.",
    solve=solve,
    robust=True,
    streamable=True,
)
