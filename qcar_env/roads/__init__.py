"""Roads: height and slope over the distance, with kinks.

profile      what a road is, and what every finite shape is
shapes       sine, humps, bars, steps
flat_tops    tables and cushions: humps with a plateau between ramps
sum_of_sines an endless sum of sines
train        several humps of one shape
functions    a road from plain Python functions
measured     a road from samples
files        a road from a file: csv_file, erd_file, crg_file; samples is what they read
iso8608      random roads of the classes A to H
enveloping   what a tyre of finite size makes of a road
iri          the International Roughness Index of a profile
humps        where the humps of a profile are, how high and how long
"""

from qcar_env.roads.files import load
from qcar_env.roads.humps import FoundHump, find_humps
from qcar_env.roads.iri import international_roughness_index
from qcar_env.roads.measured import SampledRoad

__all__ = ["FoundHump", "SampledRoad", "find_humps", "international_roughness_index", "load"]
