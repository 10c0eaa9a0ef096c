"""The undamped iteration of the thesis: the implicit loop in full Gauss-Newton steps, for study."""

from loopcal.estimation.methods.implicit_loop import METHOD as IMPLICIT_LOOP
from loopcal.estimation.methods.method import Method
from loopcal.estimation.solve.fallback import iterate_undamped

METHOD = Method(
    name="implicit-loop-undamped",
    label="implicit loop, the undamped iteration of the thesis",
    description="Implicit loop by the undamped iteration of the thesis: every sensor is "
    "uncertain, full Gauss-Newton steps.",
    solve=iterate_undamped,
    damped=IMPLICIT_LOOP,
)
