"""The loops of this mechanism: a two-link arm whose end point pulls a draw-wire encoder."""

import numpy as np


def loops(x, p):
    """One value per loop equation, zero where the loop closes.

    x: what is read in a pose, p: the parameters, both by name, in SI units (m, rad).
    NumPy's functions and plain arithmetic work on them; comparisons do not.
    """
    elbow = x.phi1
    tip = elbow + x.phi2 + p.offset
    across = p.l1 * np.cos(elbow) + p.l2 * np.cos(tip) - p.anchor_x
    up = p.l1 * np.sin(elbow) + p.l2 * np.sin(tip) - p.anchor_y
    # from the wire's outlet to the end point; the encoder counts from some unknown length
    return [np.hypot(across, up) - p.zero - x.wire]
