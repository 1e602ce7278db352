"""Graphs of measurements and models: the paper's figures 5 to 9, the iridescence path, maps over
receiving × tilt, the mirror ridge, uncertainties, and where two measurements differ.

Drawn with Matplotlib's objects alone: no pyplot, no windows, no settings changed. (colour-science
imports pyplot for itself; nothing here uses it.)
"""

from raden_torch.packages import require

require("graphs", "plots")

from raden_torch.plots.chromaticity import plot_path
from raden_torch.plots.comparison import draw_comparison
from raden_torch.plots.lines import plot_in_plane, plot_over_tilt, plot_ridge
from raden_torch.plots.maps import plot_colour_map, plot_map, plot_std
from raden_torch.plots.polar import plot_polar
from raden_torch.plots.sheet import FIGURES, PLOT_SUFFIXES, check_plot_path, draw, save_plot
from raden_torch.plots.std_map import draw_std
from raden_torch.plots.surfaces import plot_diffuse_surface, plot_specular_surface

__all__ = [
    "FIGURES",
    "PLOT_SUFFIXES",
    "check_plot_path",
    "draw",
    "draw_comparison",
    "draw_std",
    "plot_colour_map",
    "plot_diffuse_surface",
    "plot_in_plane",
    "plot_map",
    "plot_over_tilt",
    "plot_path",
    "plot_polar",
    "plot_ridge",
    "plot_specular_surface",
    "plot_std",
    "save_plot",
]
