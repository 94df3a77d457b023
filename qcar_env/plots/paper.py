"""What the paper's Figures 3 to 14 and four of our own are made from, with their captions.

Each function runs the experiments of one figure, has it drawn by `qcar_env.plots.paper_figures`,
and says in the caption what was found, with its numbers, and where the paper says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from qcar_env.analysis import chaos
from qcar_env.analysis.paper import experiments, stability
from qcar_env.analysis.paper.forced_car import ForcedCar, stack, sweep
from qcar_env.analysis.paper.frequency_response import Response, fixed_points, response
from qcar_env.analysis.paper.hardening import Hardening
from qcar_env.analysis.simulate import Simulation
from qcar_env.control import CNVC, LNVC, NDF, PD, PPF, Passive
from qcar_env.control.law import Law
from qcar_env.plots import paper_figures

LAWS = {"none": Passive(), "cnvc": CNVC()}
DETUNINGS = ("sigma1", "sigma2")


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What a figure is made from."""

    car: ForcedCar  # without control
    quick: bool

    def under(self, law: str) -> ForcedCar:
        """Return the car under one of `LAWS`."""
        return experiments.with_law(self.car, LAWS[law])

    @property
    def period(self) -> float:
        """Period of the forcing [s]."""
        return 2.0 * np.pi / self.car.omega

    @property
    def parameters(self) -> str:
        """The car's and the forcing's parameters, for captions."""
        c = self.car.car
        return (
            f"omega1 = {c.omega1:g}, omega2 = {c.omega2:g}, omega = Omega = {self.car.omega:g} "
            f"rad/s, b1 = {c.b1:g}, b2 = {c.b2:g} 1/s, E1 = {c.E1:g}, E3 = {c.E3:g} 1/s², "
            f"E2 = {c.E2:g} 1/s, mu1 = {c.mu1:g} 1/s², mu2 = {c.mu2:g} 1/s, h = {self.car.h:g} m, "
            f"f = {self.car.f:g} m/s² (calibrated, not the authors' values)"
        )


Made = tuple[Figure, str]


def figure_3(subject: Subject) -> Made:
    """Time history and phase plane with and without CNVC."""
    motions = experiments.time_histories(subject.car, LAWS, duration=60.0)
    shown = 15.0
    figure = paper_figures.time_and_phase(motions, subject.period, shown)
    peaks = {law: (_steady(m.x1), _steady(m.x2)) for law, m in motions.items()}
    reduction = [100 * (a / b - 1) for a, b in zip(peaks["none"], peaks["cnvc"], strict=True)]
    return figure, (
        "Time history from rest, last five periods of 60 s, and phase plane of wheel and body in "
        "the worst case, without control and with CNVC (G1 = G2 = 1.2 s/m²). Amplitudes "
        f"{peaks['none'][0]:.3f} and {peaks['none'][1]:.3f} m without, {peaks['cnvc'][0]:.4f} and "
        f"{peaks['cnvc'][1]:.4f} m with control: (vA1 - vA2)/vA2 = {reduction[0]:.0f} % and "
        f"{reduction[1]:.0f} % (paper: 814 % and 2556 %). The uncontrolled motion is periodic, "
        "not chaotic as section 5 says."
    )


def figure_4(subject: Subject) -> Made:
    """Response curves against both detunings."""
    curves = _curves(subject)
    return paper_figures.responses(curves), (
        "Averaged steady-state amplitudes against (a) sigma1 and (b) sigma2, the other detuning "
        "zero, without control and with CNVC (G = 1.2 s/m²); coefficients frozen at omega. "
        f"{_stability(curves['sigma1'], curves['sigma2'])}: the paper's 'stable in the right "
        "branch, unstable in the left' was not found with any correct reading of its equations."
    )


def _effects(number: int) -> Callable[[Subject], Made]:
    effects = next(each for each in experiments.EFFECTS if each.figure == number)

    def make(subject: Subject) -> Made:
        names = list(effects.claims)[:3] if subject.quick else list(effects.claims)
        car = subject.under("cnvc")
        curves = {name: experiments.parameter_effect(car, effects, name) for name in names}
        panels = {
            name: {str(i): curve.response for i, curve in enumerate(each)}
            for name, each in curves.items()
        }
        found = [t for t in experiments.trends(car) if t.figure == number]
        kinds = {
            kind: ", ".join(t.parameter for t in found if t.verdict == kind) or "none"
            for kind in ("holds", "negligible", "contradicts")
        }
        return paper_figures.parameter_effects(effects, curves), (
            f"Effect of each parameter on {effects.amplitude} against {effects.against} under CNVC "
            f"(G = 1.2 s/m²), averaged. {_stability(*panels.values())}. Each parameter at "
            "0.7, 1 and 1.3 times its value, f at the preset's, 60 and 100 m/s². At given "
            "detunings no frequency "
            "moves alone (omega_i = omega + sigma_i): omega, omega1 and omega2 scale all of them "
            "together, so these panels are alike. Statements of section 5.2 that hold: "
            f"{kinds['holds']}; effect under 1 %: {kinds['negligible']}; contradicted: "
            f"{kinds['contradicts']}. No tranquillising effect of a large f was found: "
            f"{effects.amplitude} grows with f."
        )

    make.__doc__ = f"Effects of the parameters on {effects.amplitude} against {effects.against}."
    return make


def figure_9(subject: Subject) -> Made:
    """Effect of the frequencies in the worst case with control."""
    car, w = subject.under("cnvc"), subject.car.omega
    chosen = [round(w * factor) for factor in (0.6, 1.0, 1.4)]
    histories = {}
    for omega in chosen:
        moved = car.vary("frequencies", float(omega))
        (motion,) = experiments.time_histories(moved, {"c": moved.law}, duration=20.0).values()
        histories[float(omega)] = motion
    curves = {
        law: experiments.amplitude_against(subject.under(law), "frequencies", 0.5 * w, 1.5 * w)
        for law in LAWS
    }
    return paper_figures.frequency_effect(histories, curves, 0.5), (
        "Effect of the common frequency omega = omega1 = omega2 = Omega: (a) steady motion with "
        "CNVC (G = 1.2 s/m²) from simulation, (b) averaged amplitude against it. Amplitudes fall "
        "with the frequency, as the paper says, with and without control."
    )


def figure_10(subject: Subject) -> Made:
    """Amplitude against the hump's height for several frequencies and forces."""
    car, w = subject.under("cnvc"), subject.car.omega
    values = {
        "frequencies": [round(w * factor) for factor in (0.6, 1.0, 1.4)],
        "f": [round(0.5 * car.f, 1), car.f, 60.0],
    }
    panels = {
        name: {
            float(v): experiments.amplitude_against(car.vary(name, v), "h", 1e-3, 2.0 * car.h)
            for v in each
        }
        for name, each in values.items()
    }
    return paper_figures.hump_height(panels), (
        "Averaged amplitude against the hump's height h under CNVC (G = 1.2 s/m²) for several (a) "
        "common frequencies omega = omega1 = omega2 = Omega and (b) forces f. The wheel's "
        "amplitude grows with the cube root of h where the cubic damping rules; the body's is "
        "almost independent of h, because E3 couples it weakly to the wheel, and grows with f."
    )


def figure_11(subject: Subject) -> Made:
    """Constant step hump."""
    laws = {"none": Passive(), "cnvc": CNVC(), "lnvc": LNVC()}
    both = [
        experiments.step_hump(subject.car, laws, duration=2.0, with_force=w) for w in (False, True)
    ]
    static = subject.car.car.mu1 * subject.car.h / subject.car.car.omega1**2
    rise = float(np.abs(both[0]["none"].x1).max())
    return paper_figures.step_hump(*both), (
        "Answer from rest to the step hump y = h, (a) without and (b) with the external force. "
        f"Without it the wheel rises to {rise:.3f} m and settles about {static:.3f} m (mu1 "
        "h/omega1²), and the body hardly moves: 'very small' amplitudes and 'no benefit from "
        "control', as the paper says, are seen of the body alone, and only then; with the force "
        "the body resonates and control matters. The paper "
        "does not state whether f acts here, nor which two controls it compares."
    )


def figure_12(subject: Subject) -> Made:
    """Comparison of the laws."""

    def run(law: Law) -> Simulation:
        return experiments.time_histories(subject.car, {"one": law}, duration=25.0)["one"]

    none = ("none", run(Passive()))
    tried = (
        {"PPF, G = 30": PPF(G1=30.0, G2=30.0), "PPF, G = 70": PPF(G1=70.0, G2=70.0)},
        {"NDF, G = 1.2": NDF(), "CNVC, G = 0.5": CNVC(G1=0.5, G2=0.5), "CNVC, G = 1.2": CNVC()},
        {"LNVC, G = 1.2": LNVC(), "PD, p = 30, d = 1.2": PD()},
    )
    rows = [
        {"no control": none, **{key: (law.name.lower(), run(law)) for key, law in row.items()}}
        for row in tried
    ]
    cubic, linear = (
        (_steady(motion.u1), _steady(motion.u2))
        for motion in (rows[1]["CNVC, G = 1.2"][1], rows[2]["LNVC, G = 1.2"][1])
    )
    return paper_figures.law_comparison(rows, subject.period, 20.0), (
        "Largest displacement of each period, from rest, under (a) PPF at two gains, (b) "
        "CNVC and NDF, (c) LNVC and PD, the laws that the paper names but does not draw. The "
        "paper prints no filter for PPF and NDF; ours are the literature's with calibrated "
        "damping. At equal gain CNVC leaves the least, as the paper says; equal gain is not equal "
        f"force (steady peaks of CNVC with G = 1.2: {cubic[0]:.0f} and {cubic[1]:.0f} m/s², of "
        f"LNVC with G = 1.2: {linear[0]:.0f} and {linear[1]:.0f} m/s²)."
    )


def figure_13(subject: Subject) -> Made:
    """Numerical against averaged solution."""
    both = {law: experiments.transient(subject.under(law), duration=40.0) for law in LAWS}
    worst = max(
        abs(a / _steady(x) - 1.0)
        for each in both.values()
        for a, x in (
            (each.averaged.a1[-1], each.numerical.x1),
            (each.averaged.a2[-1], each.numerical.x2),
        )
    )
    shown = {"none": 15.0, "cnvc": 1.0}
    return paper_figures.numerical_and_averaged(both, subject.period, shown), (
        "Numerical solution of the full equations (line) and averaged solution (dashed: envelope "
        "on the left, motion on the right) (a) without and (b) with CNVC (G = 1.2 s/m²), from "
        f"rest. Steady amplitudes differ by {100 * worst:.1f} % at most."
    )


def figure_14(subject: Subject) -> Made:
    """Response curves with simulated points on them."""
    curves = _curves(subject)
    values = np.linspace(-20.0, 20.0, 11 if subject.quick else 41)
    simulated = {
        d: {law: experiments.simulated_points(subject.under(law), d, values) for law in LAWS}
        for d in DETUNINGS
    }
    exact = {
        d: {
            law: response(
                subject.under(law), d, -20.0, 20.0, method="harmonic balance",
                harmonics=1 if law == "none" else 5, longest=0.1,
            )
            for law in LAWS
        }
        for d in DETUNINGS
    }  # fmt: skip
    errors = _errors(subject, simulated)
    return paper_figures.responses(curves, simulated, exact), (
        "As Fig. 4, with the largest displacement of simulations of 80 s on it (circles) and "
        "harmonic balance (dotted; one harmonic without control, five with). Averaging with frozen "
        f"coefficients is within {errors[1]:.1f} % for |sigma| <= 1, {errors[5]:.1f} % for |sigma| "
        f"<= 5 and {errors[20]:.0f} % for |sigma| <= 20 rad/s: the agreement that the paper "
        "reports holds near resonance. Harmonic balance stays on the points everywhere."
    )


def accuracy(subject: Subject) -> Made:
    """Where averaging fails."""
    values = np.linspace(-20.0, 20.0, 21 if subject.quick else 81)
    panels = {
        law: {d: experiments.approximation_errors(subject.under(law), d, values) for d in DETUNINGS}
        for law in LAWS
    }
    return paper_figures.accuracy(panels), (
        "Error of the amplitude (the larger of both masses') against long simulations: first-order "
        "averaging with coefficients frozen at omega and with the natural frequencies in them as "
        "printed, harmonic balance with one and with nine harmonics. Grey: |sigma| <= 5 rad/s, "
        "where averaging with frozen coefficients stays below 5 %. Without control the motion is "
        "harmonic and one harmonic is exact; the floor is the time step of the simulation, at "
        "whose instants the peak is read."
    )


def hardening(subject: Subject) -> Made:
    """Folds of the response with a hardening spring."""
    car = experiments.with_law(subject.car, Hardening(alpha2=800.0))
    found = experiments.folded_response(
        car, "sigma2", -20.0, 6.0, points=9 if subject.quick else 27
    )
    folds = ", ".join(f"{each.value:.2f}" for each in found.balanced.folds)
    return paper_figures.hardening(found), (
        "The same car with a hardening spring on the body (u2 = -800 x2³ m/s²), without control: "
        "the response bends, and between the folds (ticks, at sigma2 = "
        f"{folds} rad/s by harmonic balance with five harmonics) two stable motions coexist with "
        "an unstable one (dashed). Triangles: simulations with sigma2 rising and falling step by "
        "step, which jump at the folds."
    )


def stability_figure(subject: Subject) -> Made:
    """Stability over two parameters, and averaging against Floquet."""
    size = 31 if subject.quick else 121
    found = stability.stability_map(
        subject.car, "E3", np.linspace(0.5, 600.0, size), "E2", np.linspace(0.0, 8.0, size)
    )
    values = np.linspace(0.5, 600.0, 13 if subject.quick else 25)
    growth = {
        law: (
            values,
            stability.compare_with_floquet(stack(list(sweep(subject.under(law), "E3", values)))),
        )
        for law in LAWS
    }
    loss = stability.first_loss(subject.car, "E3", 0.5, 600.0)
    at = f"{loss.value:.0f} 1/s² ({loss.kind})" if loss else "no value shown"
    return paper_figures.stability(found, growth, "E3"), (
        "(a) Largest growth rate of the averaged motion without control over the couplings E3 and "
        "E2; beyond the line the motion is unstable. (b) Growth rates of the averaged motion "
        "(lines) and from Floquet multipliers of the full equations (circles) against E3. A "
        "coupling E3 far above that of a spring between the masses, E1 m1/m2, feeds energy in: "
        f"without control stability is lost at E3 = {at}; CNVC keeps the motion stable."
    )


def chaos_figure(subject: Subject) -> Made:
    """Is the uncontrolled motion chaotic."""
    sections, exponents = {}, {}
    start = np.array([[0.3], [0.1], [0.0], [-2.0]])
    count = 60 if subject.quick else 150
    for law in LAWS:
        cars = stack([subject.under(law)])
        sections[law] = chaos.poincare_section(cars, start, periods=30, settle=3 * count, steps=64)
        exponents[law] = chaos.largest_lyapunov_exponent(
            cars, start, np.random.default_rng(0), periods=count, settle=20, steps=64
        )
    values = ", ".join(f"{found.exponent[0]:.2f} 1/s ({law})" for law, found in exponents.items())
    return paper_figures.chaos(sections, exponents, subject.period), (
        "Poincaré sections of (a) wheel and (b) body, once a period, after a transient: each a "
        "single point, so the motion is periodic. (c) Running estimate of the largest Lyapunov "
        f"exponent: {values}. It is negative: there is no chaos, with or without control, "
        "against the paper's remark on 'dynamic chaos' (a linear plant cannot be chaotic)."
    )


FIGURES: dict[str, Callable[[Subject], Made]] = {
    "3": figure_3,
    "4": figure_4,
    **{str(number): _effects(number) for number in (5, 6, 7, 8)},
    "9": figure_9,
    "10": figure_10,
    "11": figure_11,
    "12": figure_12,
    "13": figure_13,
    "14": figure_14,
    "accuracy": accuracy,
    "hardening": hardening,
    "stability": stability_figure,
    "chaos": chaos_figure,
}


def _curves(subject: Subject) -> dict[str, dict[str, Response]]:
    return {
        d: {law: experiments.response_of(subject.under(law), d) for law in LAWS} for d in DETUNINGS
    }


def _stability(*groups: Mapping[str, Response]) -> str:
    """Say in words whether all motions of some responses are stable."""
    curves = [curve for group in groups for curve in group.values()]
    folds = sum(len(curve.folds) for curve in curves)
    if all(bool(curve.stable.all()) and curve.complete for curve in curves) and not folds:
        return "Every motion is stable and there is no fold"
    return f"Dashed motions are unstable; {folds} folds"


def _errors(
    subject: Subject, simulated: Mapping[str, Mapping[str, experiments.SimulatedPoints]]
) -> dict[int, float]:
    """Return the largest error of averaging [%] for |sigma| up to some limits [rad/s]."""
    largest: dict[int, float] = dict.fromkeys((1, 5, 20), 0.0)
    for against, by_law in simulated.items():
        for law, truth in by_law.items():
            found = fixed_points(stack(list(sweep(subject.under(law), against, truth.values))))
            error = np.maximum(np.abs(found.a1 / truth.a1 - 1.0), np.abs(found.a2 / truth.a2 - 1.0))
            for limit in largest:
                worst = 100.0 * float(error[np.abs(truth.values) <= limit].max())
                largest[limit] = max(largest[limit], worst)
    return largest


def _steady(x: NDArray[np.float64]) -> float:
    """Return the largest displacement of the last half second."""
    return float(np.max(np.abs(x[-500:])))
