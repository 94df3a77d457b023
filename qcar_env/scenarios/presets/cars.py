"""Quarter cars by name, with the sources of their numbers.

A corner of a car: the body's mass on one wheel, that of the wheel with what moves with it, spring
and damper at the wheel, tyre. The tyre lifts off, and travel ends at stops. Few sources give stops:
where they do not, they are those that Project Chrono has for its FEDA vehicle (`FEDA_STOPS`),
scaled by the static load, 80 mm away from rest either way, which is chosen here.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from qcar_env.parts.damper import Damper, LinearDamper, TableDamper
from qcar_env.parts.spring import LinearSpring, NoStops, TableStops
from qcar_env.parts.tyre import LiftOffTyre, LinearTyre
from qcar_env.physics.car import QuarterCar
from qcar_env.validation import known

GRAVITY = 9.81  # [m/s^2]
CLEARANCE = 0.08  # [m] to the stops, chosen here: what test cars of many papers are allowed
# Project Chrono, src/chrono_models/vehicle/feda/FEDA_DoubleWishbone.cpp: depth [m], force [N]
FEDA_STOPS = (
    (0.0, 0.0),
    (0.01, 1_000.0),
    (0.02, 2_500.0),
    (0.03, 4_500.0),
    (0.04, 7_500.0),
    (0.05, 12_500.0),
    (0.06, 125_000.0),
)
FEDA_LOAD = 20_000.0  # [N] static load of a corner that goes with them, estimated
PAYLOAD = 100.0  # [kg] on a corner, chosen here: a quarter of four people and their luggage

COMMONROAD = (
    "CommonRoad vehicle models 3.0.2 (TU Munich), vehiclemodels/parameters/parameters_vehicle{}"
    ".yaml, from data of the US Department of Transportation; a corner has half its axle's share "
    "of the body"
)


@dataclass(frozen=True, kw_only=True)
class CarPreset:
    """A corner of a car.

    Parameters
    ----------
    title : str
        What it is, for people.
    source : str
        Where the numbers come from.
    car : QuarterCar
        It, empty.
    loads : mapping of str to float
        Mass that comes on the body [kg], by name.
    """

    title: str
    source: str
    car: QuarterCar
    loads: Mapping[str, float]


def _corner(
    title: str,
    source: str,
    *,
    m2: float,
    m1: float,
    k2: float,
    c2: float | Damper,
    k1: float,
    c1: float = 0.0,
    payload: float = PAYLOAD,
) -> CarPreset:
    """Return a preset from masses [kg], stiffnesses [N/m] and damping [N s/m]."""
    scale = m2 * GRAVITY / FEDA_LOAD
    stops = TableStops(
        bump=CLEARANCE,
        rebound=CLEARANCE,
        depths=tuple(depth for depth, _ in FEDA_STOPS),
        forces=tuple(scale * force for _, force in FEDA_STOPS),
    )
    made = QuarterCar(
        m1=m1,
        m2=m2,
        spring=LinearSpring(k=k2),
        damper=c2 if isinstance(c2, Damper) else LinearDamper(c=c2),
        tyre=LiftOffTyre(k=k1, c=c1),
        stops=stops,
    )
    loads = MappingProxyType({"empty": 0.0, "laden": payload})
    return CarPreset(title=title, source=source, car=made, loads=loads)


# The damper of the HMMWV at its wheel: force at +-0.333 and +-0.667 m/s at mid stroke of the shock
# absorber, which moves 0.39 times as far as the wheel (motion ratio derived from the geometry).
_HMMWV_RATIO = 0.39
_HMMWV_DAMPER = TableDamper(
    rates=tuple(rate / _HMMWV_RATIO for rate in (-0.667, -0.333, 0.0, 0.333, 0.667)),
    forces=tuple(force * _HMMWV_RATIO for force in (-14_973.3, -7_486.67, 0.0, 4_173.85, 8_347.71)),
)

CARS: Mapping[str, CarPreset] = MappingProxyType(
    {
        "escort": _corner(
            "Ford Escort, front",
            COMMONROAD.format(1),
            m2=345.1,
            m1=32.84,
            k2=21_898.0,
            c2=1_459.4,
            k1=189_785.6,
        ),
        "escort-rear": _corner(
            "Ford Escort, rear",
            COMMONROAD.format(1),
            m2=202.2,
            m1=32.84,
            k2=21_898.0,
            c2=1_459.4,
            k1=189_785.6,
        ),
        "bmw-320i": _corner(
            "BMW 320i, front",
            COMMONROAD.format(2),
            m2=266.4,
            m1=31.90,
            k2=24_453.0,
            c2=1_786.2,
            k1=158_294.0,
        ),
        "vanagon": _corner(
            "VW Vanagon, a van, front",
            COMMONROAD.format(3),
            m2=351.8,
            m1=40.57,
            k2=33_577.0,
            c2=2_405.6,
            k1=212_641.6,
            payload=200.0,
        ),
        "megane": _corner(
            "Renault Megane coupe",
            "normal-kim/SuspensionBO, matlab/suspension_active.m, after the car of papers from "
            "Grenoble and Milan; damping recalled, not checked",
            m2=315.0,
            m1=37.5,
            k2=29_500.0,
            c2=1_500.0,
            k1=210_000.0,
        ),
        "hub-motor": _corner(
            "Ford Escort, front, with a motor in the wheel",
            COMMONROAD.format(1)
            + "; on the wheel a ProteanDrive 16 (27 kg) and what holds it (3 kg, "
            "chosen here)",
            m2=345.1,
            m1=32.84 + 30.0,
            k2=21_898.0,
            c2=1_459.4,
            k1=189_785.6,
        ),
        "heavy-axle": _corner(
            "End of a heavy truck's or bus's axle, half laden",
            "excerpt of a public repository, not checked; loads chosen here",
            m2=5_333.0,
            m1=906.5,
            k2=430_000.0,
            c2=20_000.0,
            k1=2_440_000.0,
            payload=1_500.0,
        ),
        "mathworks": _corner(
            "Passenger car of MathWorks' example",
            "MathWorks, Robust Control of Active Suspension (quarter-car example)",
            m2=300.0,
            m1=60.0,
            k2=16_000.0,
            c2=1_000.0,
            k1=190_000.0,
        ),
        "ctms-bus": _corner(
            "Bus of the Control Tutorials for MATLAB and Simulink",
            "sriram-2502/quarter-car-control-lab, solutions/README.md",
            m2=2_500.0,
            m1=320.0,
            k2=80_000.0,
            c2=350.0,
            k1=500_000.0,
            c1=15_020.0,
            payload=700.0,
        ),
        "golden-car": _corner(
            "Golden Car of the International Roughness Index",
            "M. W. Sayers, Transportation Research Record 1501 (1995) 1, for 1 kg of body; 250 kg, "
            "chosen here, change no motion",
            m2=250.0,
            m1=0.15 * 250.0,
            k2=63.3 * 250.0,
            c2=6.0 * 250.0,
            k1=653.0 * 250.0,
        ),
        "hmmwv": _corner(
            "HMMWV, front",
            "Project Chrono, data/vehicle/hmmwv/suspension (wheel, damper at mid stroke); body a "
            "quarter of 2086 kg, recalled; spring 167 062 N/m at a motion ratio of 0.39; tyre "
            "chosen here",
            m2=2_086.0 / 4.0,
            m1=64.0,
            k2=167_062.0 * _HMMWV_RATIO**2,
            c2=_HMMWV_DAMPER,
            k1=300_000.0,
            payload=280.0,
        ),
        "delft": _corner(
            "Car of the course RO47017, TU Delft",
            "course text: damping 0.3 of critical",
            m2=410.0,
            m1=45.0,
            k2=25_500.0,
            c2=0.3 * 2.0 * math.sqrt(25_500.0 * 410.0),
            k1=230_000.0,
        ),
        "alleyne-hedrick": _corner(
            "Car of the papers on hydraulic suspensions",
            "Alleyne and Hedrick 1995, Lin and Kanellakopoulos 1997, as in "
            "Galabavamsi/quarter-car-afc-replication, afc2/qc_params.m",
            m2=290.0,
            m1=59.0,
            k2=16_812.0,
            c2=1_000.0,
            k1=190_000.0,
        ),
        "na-2022": _corner(
            "Car of Na et al.",
            "IEEE Trans. Systems, Man, and Cybernetics: Systems 52(8), 2022, as in "
            "Galabavamsi/quarter-car-afc-replication",
            m2=320.0,
            m1=40.0,
            k2=18_000.0,
            c2=1_000.0,
            k1=200_000.0,
        ),
        "lqr-study": _corner(
            "Car of a MATLAB study of LQR",
            "README of the study",
            m2=400.0,
            m1=40.0,
            k2=20_000.0,
            c2=1_500.0,
            k1=190_000.0,
        ),
        "air-spring": _corner(
            "Passenger car with air springs, front, linearised",
            "ISRN Mechanical Engineering 2015, 974020, table 2",
            m2=365.0,
            m1=40.0,
            k2=19_960.0,
            c2=1_290.0,
            k1=175_500.0,
            c1=14.6,
        ),
    }
)


def car(name: str, *, load: str = "empty", stops: bool = True, lift_off: bool = True) -> QuarterCar:
    """Return a car by its name.

    Parameters
    ----------
    name : str
        One of `CARS`.
    load : str
        One of its loads: ``"empty"``, ``"laden"``. The stops keep their place in the car, of which
        a load on linear springs takes away; this is not counted, as cars are measured from rest.
    stops : bool
        Whether travel ends at stops.
    lift_off : bool
        Whether the tyre can lift off. A car with neither, and with a linear damper, is linear.

    Raises
    ------
    ValueError
        If there is no such car or load.
    """
    preset = CARS[known("car", name, CARS)]
    found = preset.car
    mass = found.m2 + preset.loads[known(f"load of {name}", load, preset.loads)]
    tyre = found.tyre
    return dataclasses.replace(
        found,
        m2=mass,
        stops=found.stops if stops else NoStops(),
        tyre=tyre if lift_off else LinearTyre(k=tyre.k, c=tyre.c),  # pyright: ignore
    )
