"""Frequency response of your own car, with and without control.

python docs/tutorials/frequency_response.py
"""

# %% [markdown]
# # Frequency response of your own car
#
# Give masses, springs and dampers, and follow the steady motion against the frequency of the
# road, that is against the speed of the car.

# %%
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from qcar_env.analysis.paper.forced_car import ForcedCar
from qcar_env.analysis.paper.frequency_response import response
from qcar_env.control import CNVC, LNVC, Passive
from qcar_env.physics.car import PaperCar
from qcar_env.physics.linear import modes
from qcar_env.plots.response import response_curve
from qcar_env.plots.style import journal, line

SHORT = "--short" in sys.argv

# %% [markdown]
# ## The car
#
# A small car's corner: 250 kg of body on 35 kg of wheel. Its two modes are a factor of nine apart;
# in every car in print it is 7.5 to 17. The method is the paper's, so the car is a `PaperCar`:
# linear, by its coefficients.

# %%
car = PaperCar.from_physical(m1=35.0, m2=250.0, k1=180e3, k2=18e3, c1=50.0, c2=900.0)
for number, mode in enumerate(modes(car), start=1):
    print(f"mode {number}: {mode.frequency:.2f} rad/s, damping ratio {mode.damping_ratio:.3f}")

# %% [markdown]
# ## The response
#
# `response` follows the periodic motion of the full equations by harmonic balance, round folds
# where there are any, and tells which motions are stable. The road is a harmonic one, 1 cm high.

# %%
lowest, highest = 3.0, 12.0 if SHORT else 120.0
curves = {}
for name, law in (
    ("none", Passive()),
    ("lnvc", LNVC(G1=0.0, G2=8.0)),
    ("cnvc", CNVC(G1=0.0, G2=800.0)),
):
    forced = ForcedCar(car=car, h=0.01, f=0.0, omega=10.0, law=law)
    curves[name] = response(
        forced, "omega", lowest, highest, method="harmonic balance", harmonics=3
    )
    found = curves[name]
    worst = int(np.argmax(found.a2))
    print(
        f"{name}: body at most {1e3 * found.a2[worst]:.1f} mm, at {found.values[worst]:.1f} rad/s"
    )

# %% [markdown]
# ## The figure
#
# Colours and lines are those of every figure of the library. At the body's resonance linear
# feedback helps most; the cubic law acts where the body is fast and does next to nothing at small
# amplitudes, which is what "cubic" means.

# %%
out = Path("results/tutorials")
out.mkdir(parents=True, exist_ok=True)
with journal():
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 2.8))
    for ax, amplitude, mass in zip(axes, ("a1", "a2"), ("wheel", "body"), strict=True):
        for name, curve in curves.items():
            style = line(name)
            response_curve(ax, curve, amplitude, label=style.label, color=style.color)
        ax.set_xscale("log")
        ax.set_xlabel(r"frequency of the road $\omega$ [rad/s]")
        ax.set_ylabel(f"amplitude of the {mass} [m]")
    axes[0].legend()
    figure.savefig(out / "frequency_response.png")

# %% [markdown]
# ![Amplitude of wheel and body against the frequency of the
# road](../_static/frequency_response.png)
