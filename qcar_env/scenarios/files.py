"""Scenarios as plain records, and as TOML and JSON texts and files."""

from __future__ import annotations

import dataclasses
import importlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from types import FunctionType
from typing import Any, cast

from qcar_env.parts import actuator, damper, sensor, spring, tyre
from qcar_env.parts.part import Part
from qcar_env.physics import car, external_force
from qcar_env.roads import (
    flat_tops,
    functions,
    iso8608,
    measured,
    shapes,
    sum_of_sines,
    train,
)
from qcar_env.scenarios import randomise, reference
from qcar_env.scenarios.presets import SCENARIOS
from qcar_env.scenarios.scenario import Scenario
from qcar_env.validation import known, shown

_HOMES = (
    *(spring, damper, tyre, actuator, sensor),
    *(car, external_force),
    *(shapes, flat_tops, sum_of_sines, train, measured, iso8608, functions),
    *(randomise, reference),
)
KIND = "kind"  # the key that names a record's class
FUNCTION = "function"  # the only key of a record that names a function


def kinds() -> dict[str, type]:
    """Return the classes that a record can name, by name."""
    return {
        name: each
        for home in _HOMES
        for name, each in vars(home).items()
        if isinstance(each, type) and dataclasses.is_dataclass(each) and not name.startswith("_")
    }


def as_record(value: Any) -> Any:
    """Return a scenario, or a part of one, as dicts, lists, numbers and texts.

    Raises
    ------
    ValueError
        If a class of one's own cannot be found again: it must stand at the top of a module.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {
            each.name: as_record(getattr(value, each.name)) for each in dataclasses.fields(value)
        }
        fields = {name: each for name, each in fields.items() if each is not None}
        return fields if isinstance(value, Scenario) else {KIND: _name(type(value)), **fields}
    if isinstance(value, Mapping):
        return {str(name): as_record(each) for name, each in value.items()}  # pyright: ignore
    if isinstance(value, (tuple, list)):
        return [as_record(each) for each in value]  # pyright: ignore
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, FunctionType):
        return {FUNCTION: _place(value)}
    raise ValueError(f"{shown(value)} cannot be written down; give numbers and texts")


def _name(kind: type) -> str:
    known_one = kinds().get(kind.__name__, type(None))
    # a train's class is made for its shape, below the one that has its name; a class of one's own
    # below one of the library is another
    if issubclass(kind, known_one) and kind.__module__ == known_one.__module__:
        return kind.__name__
    return _place(kind)


def _place(named: Any) -> str:
    """Return where a class or function is found again, as ``module:name``."""
    name = named.__qualname__
    if "<" in name or named.__module__ == "__main__":
        raise ValueError(
            f"{name} cannot be found again by its name; define it at the top of a module that can "
            "be imported (a road from a function can be sampled: SampledRoad.from_function)"
        )
    return f"{named.__module__}:{name}"


def from_record(record: Mapping[str, Any]) -> Scenario:
    """Return the scenario of a record (see `as_record`).

    Raises
    ------
    ValueError
        If a key or a class is unknown, or a number is out of range; the message says where.
    """
    return cast("Scenario", _build(Scenario, record, "scenario"))


def _build(kind: type, record: Any, where: str) -> Any:
    if not isinstance(record, Mapping):
        raise ValueError(f"{where} must be a table of numbers, got {shown(record)}; give one")
    fields = {each.name: each for each in dataclasses.fields(kind) if each.init}
    given: dict[str, Any] = {}
    for name, value in cast("Mapping[str, Any]", record).items():
        if name != KIND:
            known(f"entry of {where}", name, fields)
            given[name] = _value(value, f"{where}.{name}")
    try:
        return kind(**given)
    except TypeError:
        missing = [
            name
            for name, each in fields.items()
            if name not in given
            and each.default is dataclasses.MISSING
            and each.default_factory is dataclasses.MISSING
        ]
        raise ValueError(f"{where} lacks {', '.join(missing) or 'an entry'}; add it") from None


def _value(value: Any, where: str) -> Any:
    if isinstance(value, Mapping):
        record = cast("Mapping[str, Any]", value)
        if set(record) == {FUNCTION}:
            return imported(f"function of {where}", record[FUNCTION])
        if KIND not in record:
            return {name: _value(each, f"{where}.{name}") for name, each in record.items()}
        return _build(_kind(record[KIND], where), record, where)
    if isinstance(value, list):
        return tuple(_value(each, f"{where}.{i}") for i, each in enumerate(value))  # pyright: ignore
    return value


def _kind(name: Any, where: str) -> type:
    if isinstance(name, str) and ":" in name:
        found = imported(f"kind of {where}", name)
        if not (isinstance(found, type) and issubclass(found, Part)):
            raise ValueError(f"{where} names {name!r}, which is no part; give a subclass of Part")
        return found
    return kinds()[known(f"kind of {where}", name, kinds())]


def imported(what: str, spec: Any) -> Any:
    """Return the object of ``module:object``, as Python imports it from the current folder.

    Raises
    ------
    ValueError
        If it is not there, or the module raises anything while it is imported.
    """
    module, _, place = str(spec).partition(":")
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        found: Any = importlib.import_module(module)
        for each in place.split("."):
            found = getattr(found, each)
    except (Exception, SystemExit) as error:  # the module is the user's: whatever it raises
        raise ValueError(
            f"no {what} {spec!r}: {type(error).__name__}: {error}; "
            "give module:object as Python imports it from this folder"
        ) from error
    return found


def to_json(scenario: Scenario) -> str:
    """Return a scenario as JSON."""
    return json.dumps(as_record(scenario))


def to_toml(scenario: Scenario) -> str:
    """Return a scenario as TOML."""
    import tomli_w

    return tomli_w.dumps(as_record(scenario))


def from_text(text: str) -> Scenario:
    """Return the scenario of a JSON or a TOML text.

    Raises
    ------
    ValueError
        If it is neither, or not that of a scenario.
    """
    try:
        import tomllib  # pyright: ignore[reportMissingImports]  from Python 3.11 on
    except ImportError:
        import tomli as tomllib  # pyright: ignore
    try:
        record: Any = json.loads(text) if text.lstrip().startswith("{") else tomllib.loads(text)
    except ValueError as error:
        raise ValueError(f"no scenario can be read: {error}; give valid TOML or JSON") from None
    return from_record(record)


def read(path: Path) -> Scenario:
    """Return the scenario of a TOML or JSON file (errors: `from_text`)."""
    try:
        return from_text(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def write(scenario: Scenario, path: Path) -> None:
    """Write a scenario into a ``.toml`` or ``.json`` file."""
    text = to_toml(scenario) if path.suffix == ".toml" else to_json(scenario)
    path.write_text(text, encoding="utf-8")


def scenario(name: str | Path | Scenario) -> Scenario:
    """Return a scenario by what names it, or as it is.

    Parameters
    ----------
    name : str, Path or Scenario
        A preset's name, the path of a TOML or JSON file or its text, or ``module:object``, where
        the object is a `Scenario` or makes one when it is called without arguments.

    Raises
    ------
    ValueError
        If there is no such preset (the message gives the nearest name and the list), or the file,
        text or object is not that of a scenario.
    """
    if isinstance(name, Scenario):
        return name
    if isinstance(name, Path) or (isinstance(name, str) and name.endswith((".toml", ".json"))):
        return read(Path(name))
    if isinstance(name, str) and ("\n" in name or name.lstrip().startswith("{")):
        return from_text(name)
    if isinstance(name, str) and ":" in name:
        return _object(name)
    try:
        return SCENARIOS[known("scenario", name, SCENARIOS)]
    except ValueError as error:
        raise ValueError(f"{error}; or give a TOML or JSON file, or module:object") from None


def _object(spec: str) -> Scenario:
    """Return the scenario of ``module:object``."""
    found = imported("scenario", spec)
    if callable(found):
        try:
            found = found()
        except Exception as error:  # the function is the user's: whatever it raises
            raise ValueError(
                f"no scenario {spec!r}: {type(error).__name__}: {error}; give a Scenario, or a "
                "function without arguments that returns one"
            ) from error
    if not isinstance(found, Scenario):
        raise ValueError(
            f"{spec!r} is no scenario, but {shown(found)}; give a Scenario, or a function without "
            "arguments that returns one"
        )
    return found
