"""Read and write configuration files; every fault is a sentence with its file, line and key."""

from __future__ import annotations

import difflib
import re
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar, get_args

import tomli_w
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from bench.config.calibration import Calibration
from bench.config.models import NAME_PATTERN, Config
from bench.config.syntax import describe_syntax_fault
from bench.errors import ConfigError

__all__ = [
    "RECORDING_START",
    "config_schema",
    "load_calibration",
    "load_config",
    "parse_config",
    "simulated_config",
    "simulated_config_text",
    "to_toml",
]

SELF_EXPLAINING = ("value_error", "unknown_kind")
"""Faults whose sentence is our own: the key's description would say it again."""
RECORDING_START = b"\x89MCAP"
"""How an MCAP file begins: given in place of a configuration or a take, it is told apart by that."""
Place = tuple[str | int, ...]
Model = TypeVar("Model", Config, Calibration)

UNITS = re.compile(r"_(m|mm|s|ms|ns|hz|rad|deg|per_m|n|nm2|n_per_m|ppm)$")


def load_config(path: Path) -> Config:
    """Read a configuration file, and with it the calibration file that it names.

    Raises
    ------
    ConfigError
        A file cannot be read, is no TOML, or holds an unknown key, a wrong unit or a wrong kind; all faults at once.
    """
    config = parse_config(_read(path, "configuration"), str(path))
    settings = config.calibration
    if not settings.file or settings.measured is not None:
        return config
    measured = load_calibration(path.parent / settings.file)
    return config.model_copy(update={"calibration": settings.model_copy(update={"measured": measured})})


def load_calibration(path: Path) -> Calibration:
    """Read a calibration file. Raises like `load_config`."""
    return _parse(Calibration, _read(path, "calibration"), str(path))


def parse_config(text: str, source: str) -> Config:
    """Check the text of a configuration; `source` names it in messages. Raises like `load_config`."""
    return _parse(Config, text, source)


def _read(path: Path, what: str) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # editors on Windows put a mark of three bytes before the text
    except OSError as error:
        raise ConfigError(f"The {what} {path} cannot be read: {error.strerror or error}.") from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"The {what} {path} is not UTF-8 text (byte {error.start}).", hint=_explain_bytes(error.object)
        ) from error


def _explain_bytes(content: bytes) -> str:
    if content.startswith(RECORDING_START):
        return "It is a recording: `bench report` and `bench info` take it."
    return "Save it as UTF-8 in the editor; a configuration is a text file that ends in .toml."


def _parse(model: type[Model], text: str, source: str) -> Model:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        sentence, hint = describe_syntax_fault(text, source, error)
        raise ConfigError(sentence, hint=hint) from error
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faults = [_sentence(fault, text, source, model) for fault in error.errors()]
        hint = "" if len(faults) == 1 else f"({len(faults)} faults in all.)"
        raise ConfigError("\n".join(faults), hint=hint) from error


def simulated_config_text() -> str:
    """Return the text of the simulated bench's configuration, as packaged."""
    return files("bench.config").joinpath("simulated.toml").read_text(encoding="utf-8")


def simulated_config() -> Config:
    """Return the configuration of the simulated bench."""
    return parse_config(simulated_config_text(), "simulated.toml")


def to_toml(settings: Config | Calibration) -> str:
    """Return a resolved configuration, defaults included, or a calibration, as TOML that is read back equal."""
    return tomli_w.dumps(settings.model_dump(mode="json", by_alias=True, exclude_none=True))


def config_schema() -> dict[str, Any]:
    """Return the JSON schema of a configuration file."""
    return Config.model_json_schema(by_alias=True)


def _sentence(fault: ErrorDetails, text: str, source: str, root: type[BaseModel]) -> str:
    if fault["type"] == "unknown_kind":
        fault = {**fault, "loc": (*fault["loc"], "kind"), "input": fault["input"]["kind"]}
    place, model = _follow(fault["loc"], root)
    line = _line_of(text, place)
    where = f"{source}, line {line}" if line else source
    key = ".".join(str(part) for part in place) or "the file"
    if fault["type"] == "extra_forbidden":
        return f"{where}: {key} is not a known key; {_suggestion(str(place[-1]), model)}"
    if fault["type"] == "missing":
        return f"{where}: {key} is missing{_described(str(place[-1]), model)}."
    message = _say_rule(fault)
    if isinstance(fault["input"], dict | list):
        return f"{where}: {key}: {message}."
    about = _described(str(place[-1]), model) if place and fault["type"] not in SELF_EXPLAINING else ""
    return f"{where}: {key} = {fault['input']!r}: {message[:1].lower()}{message[1:]}{about}."


def _say_rule(fault: ErrorDetails) -> str:
    if fault["type"] == "string_pattern_mismatch" and fault["ctx"]["pattern"] == NAME_PATTERN:
        return "only letters, digits, '.', '_' and '-' can stand in it, and first a letter or a digit"
    rule = fault["msg"].removeprefix("Value error, ").replace("nput should", "t must", 1)
    return rule.replace("a valid number", "a number").replace("a valid integer", "a whole number")


def _follow(loc: Place, root: type[BaseModel]) -> tuple[Place, type[BaseModel] | None]:
    """Return the keys of the file that lead to a fault, and the model that holds the last of them.

    The names of branches that pydantic adds for unions are no keys: they are dropped, and choose among models.
    """
    place: list[str | int] = []
    models: list[type[BaseModel]] = [root]
    holder: type[BaseModel] | None = root
    for part in loc:
        chosen = [model for model in models if _kind_of(model) == part] if len(models) > 1 else []
        if chosen:
            models = chosen
        elif not (isinstance(part, str) and ("[" in part or part == "tuple")):
            place.append(part)
            if isinstance(part, str):
                holder = models[0] if models else None
                field = _fields(holder).get(part) if holder else None
                models = _models_in(field.annotation) if field else []
    return tuple(place), holder


def _kind_of(model: type[BaseModel]) -> str:
    """Return the `kind` that chooses this model."""
    kind = model.model_fields.get("kind")
    return str(next(iter(get_args(kind.annotation)), "")) if kind else ""


def _fields(model: type[BaseModel]) -> dict[str, Any]:
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the models an annotation allows, whatever it wraps them in."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models_in(inner)]


def _suggestion(wrong: str, model: type[BaseModel] | None) -> str:
    if model is None:
        return "remove it."
    known = list(_fields(model))
    same_quantity = [name for name in known if UNITS.sub("", name) == UNITS.sub("", wrong)]
    if same_quantity:
        return f"the unit is part of the key: did you mean '{same_quantity[0]}'?"
    close = difflib.get_close_matches(wrong, known, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"known here: {', '.join(sorted(known))}."


def _described(key: str, model: type[BaseModel] | None) -> str:
    field = _fields(model).get(key) if model else None
    return f" ({field.description.rstrip('.')})" if field is not None and field.description else ""


def _line_of(text: str, place: Place) -> int:
    """Return the line of the deepest part of `place` that stands in the text, 0 if none does."""
    table: tuple[str, ...] = ()
    best, best_depth = 0, 0
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[+\s*([^\]]+?)\s*\]+", line)
        assignment = re.match(r"\s*([A-Za-z0-9_\-.\"']+)\s*=", line)
        if header:
            table = _parts(header.group(1))
            here = table
        elif assignment:
            here = table + _parts(assignment.group(1))
        else:
            continue
        if here == tuple(str(part) for part in place[: len(here)]) and len(here) > best_depth:
            best, best_depth = number, len(here)
    return best


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))
