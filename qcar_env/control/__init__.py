"""Control laws as pure functions, one file each, with their gains and stability remarks."""

from qcar_env.control.cnvc import CNVC
from qcar_env.control.lnvc import LNVC
from qcar_env.control.ndf import NDF
from qcar_env.control.passive import Passive
from qcar_env.control.pd import PD
from qcar_env.control.ppf import PPF

LAWS = {"none": Passive, "cnvc": CNVC, "lnvc": LNVC, "ppf": PPF, "ndf": NDF, "pd": PD}

__all__ = ["CNVC", "LAWS", "LNVC", "NDF", "PD", "PPF", "Passive"]
