"""Analysis of reconstruction filters: frequency responses, published metrics, approximation theory, measured errors.

NumPy and SciPy in float64; a device is used only on request, and to measure times.

>>> from clvol import analysis, phantoms
>>> table = analysis.compare(phantoms.marschner_lobb_function, gradient=phantoms.marschner_lobb_gradient)
>>> print(table.to_markdown())
"""

from __future__ import annotations

from clvol.analysis.angle import angles, mean_angle
from clvol.analysis.cardinal import impulse_response
from clvol.analysis.comparison import COMPARED, EXACT_SINC, ErrorRow, ErrorTable, compare
from clvol.analysis.dirichlet import SincVolume, dirichlet_kernel, dirichlet_magnify, dirichlet_sample, sinc_volume
from clvol.analysis.frequency import Bands, bands, frequency_response, prefilter_response
from clvol.analysis.gibbs import WILBRAHAM_GIBBS, StepResponse, lowpass_step, step_response
from clvol.analysis.left_out import LeftOutRow, LeftOutTable, leave_out
from clvol.analysis.marschner_lobb import Metrics, metrics
from clvol.analysis.predicted import PredictedRow, PredictedTable, jump_error, predict, variance_gain
from clvol.analysis.similarity import ssim
from clvol.analysis.table import Table
from clvol.analysis.theory import Approximation, approximation, error_kernel, taylor_coefficients
from clvol.analysis.turned import RotationRow, RotationTable, rotations

__all__ = [
    "COMPARED",
    "EXACT_SINC",
    "WILBRAHAM_GIBBS",
    "Approximation",
    "Bands",
    "ErrorRow",
    "ErrorTable",
    "LeftOutRow",
    "LeftOutTable",
    "Metrics",
    "PredictedRow",
    "PredictedTable",
    "RotationRow",
    "RotationTable",
    "SincVolume",
    "StepResponse",
    "Table",
    "angles",
    "approximation",
    "bands",
    "compare",
    "dirichlet_kernel",
    "dirichlet_magnify",
    "dirichlet_sample",
    "error_kernel",
    "frequency_response",
    "impulse_response",
    "jump_error",
    "leave_out",
    "lowpass_step",
    "mean_angle",
    "metrics",
    "predict",
    "prefilter_response",
    "rotations",
    "sinc_volume",
    "ssim",
    "step_response",
    "taylor_coefficients",
    "variance_gain",
]
