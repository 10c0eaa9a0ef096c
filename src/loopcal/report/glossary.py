"""Words of the report that a reader may want explained where they stand."""

from __future__ import annotations

GLOSSARY = {
    "rms": "Root mean square: the root of the mean of the squares.",
    "95 %": "95 % of the poses are at most so far off.",
    "sd": "Standard deviation: how uncertain the value is. The true value lies within two sds "
    "with about 95 % probability.",
    "change/sd": "Change from nominal in units of its sd. Below 2 it may be noise.",
    "prior's share": "How much of the value comes from the drawing instead of the data.",
    "nominal": "Computed with the values of the drawing, placed where the instrument sees it.",
    "nominal, best placed": "Computed with the values of the drawing after fitting where the "
    "machine stands and where the target is mounted.",
    "calibrated": "In-sample: on the poses used for the fit. Expect worse on other poses.",
    "on poses not used": "Out-of-sample: predicted by fits that did not use these poses.",
    "in regions not used": "Predicted by fits that used no pose of that region of the joints.",
    "noise floor": "What remains with the right parameters: the noise of the sensors alone.",
    "tolerance": "The distance that 95 % of poses shall keep, from [verdict] of the project.",
    "chi-squared": "Sum of squared corrections over their sds. It should be near the degrees of "
    "freedom.",
    "degrees of freedom": "Number of equations minus number of parameters.",
    "p-value": "Probability of a misfit at least so large if all sds and the model are right.",
    "statistic": "How far the pose is from what the other poses predict, in squared sds.",
    "sd of sd": "How uncertain a learnt sd is.",
    "rms corr./sd": "Rms of the corrections over the sds. A well checked sensor has about 1.",
    "redundancy": "How much of an error of this sensor the other readings reveal.",
    "detectable": "Smallest error of a single reading that the test finds.",
    "factor": "Chi-squared of the sensor over its redundancy. It is 1 where the sd is right.",
    "gain": "In -2 log likelihood. Above 10 the machine model is wrong without this term.",
}
"""Word -> its meaning in one or two sentences."""


def meaning(cell: str) -> str:
    """The meaning of a heading, "" where it has none; a unit in brackets does not matter."""
    return GLOSSARY.get(cell.split(" [")[0], "")
