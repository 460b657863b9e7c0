"""Finding methods by name: those of this folder, and those that a program has defined."""

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

import nilbs.methods
from nilbs.geometry.nearest_names import nearest_name
from nilbs.methods.base import REGISTERED, Method


def all_methods() -> dict[str, type[Method]]:
    """Every method by its name: first those that train, then those that learn nothing."""
    _import_methods()
    names = sorted(REGISTERED, key=lambda name: (not REGISTERED[name].trained, name))
    return {name: REGISTERED[name] for name in names}


def untrained() -> dict[str, type[Method]]:
    """The methods that learn nothing, which scores can set beside any model."""
    return {name: kind for name, kind in all_methods().items() if not kind.trained}


@cache
def _import_methods() -> None:
    for module in pkgutil.iter_modules(nilbs.methods.__path__):
        import_module(f"nilbs.methods.{module.name}")
    for entry in entry_points(group="nilbs.methods"):  # of packages that bring their own
        try:
            entry.load()
        except (ImportError, AttributeError, TypeError, ValueError) as error:
            raise ValueError(f"the method {entry.name!r}, {entry.value}, cannot be imported: {error}") from error


def method_of(method: Method | str, **settings: Any) -> Method:
    """A method by its name, or as it is given, with settings changed.

    Raises
    ------
    ValueError
        If there is no such method or setting.

    Examples
    --------
    >>> method_of("nasa", width=8).width
    8
    """
    if isinstance(method, Method):
        return type(method).from_settings(values_of(method) | settings)
    return method_class(method).from_settings(settings)


def method_class(name: str) -> type[Method]:
    """The method of a name.

    Raises
    ------
    ValueError
        If there is none.
    """
    known = all_methods()
    if name not in known:
        meant = nearest_name(name, known)
        raise ValueError(
            f"there is no method {name!r}{meant}; known are {', '.join(known)} (one of your own must be imported first)"
        )
    return known[name]


def values_of(method: Method) -> dict[str, Any]:
    """Settings of a method by name, as JSON holds them."""
    return {s.name: getattr(method, s.name) for s in method.settings()}


def of_version_5(values: Mapping[str, Any]) -> Method:
    """The method that the settings of a model file of version 5 describe, where all methods shared one table."""
    as_in_paper = values["supervision"] == "paper"
    kind = method_class("paper" if as_in_paper else values["method"])
    known = {s.name: s for s in kind.settings()}
    # A zero stood for the default where that depends on the character; of methods without training it was the rule.
    kept = {key: value for key, value in values.items() if key in known and not (value == 0 and known[key].least > 0)}
    if as_in_paper:
        kept["noise"] = 0.0  # its points were uniform, whatever the setting
    return kind.from_settings(kept)
