"""Auto: the other methods compete, and poses that were not used choose among them.

The competition needs statistics, so it is held above this layer
(`loopcal.statistics.choice`). By itself, as for a stream, auto is the first of its methods that can
be had.
"""

from loopcal.estimation.methods import implicit_loop, least_squares, reweighted
from loopcal.estimation.methods.method import Method

METHOD = Method(
    name="auto",
    label="chosen by validation",
    description="Auto: several methods, with a model error and without, are validated on the same "
    "poses not used; the structured one is taken unless another is significantly better.",
    solve=implicit_loop.METHOD.solve,
    robust=True,
    streamable=True,
    choice=(implicit_loop.METHOD, reweighted.METHOD, least_squares.METHOD),
)
