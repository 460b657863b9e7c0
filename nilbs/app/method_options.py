"""Options of `nilbs train` that are the settings of methods, generated from them."""

import argparse
from typing import Any

from nilbs.methods.base import Method, Setting
from nilbs.methods.registry import all_methods, method_class

# Settings that have options of their own.
_ELSEWHERE = ("seed", "steps")


def add_method(parser: argparse.ArgumentParser) -> None:
    """Add --method, and an option for each setting of each method, in groups of methods that share them."""
    methods = all_methods()
    parser.add_argument(
        "--method",
        choices=tuple(methods),
        default="nilbs",
        metavar="NAME",
        help="how the field is made: " + "; ".join(f"{name}, {kind.summary}" for name, kind in methods.items()),
    )
    owners: dict[str, dict[str, Setting]] = {}
    for method, kind in methods.items():
        for s in kind.settings():
            if s.name not in _ELSEWHERE:
                owners.setdefault(s.name, {})[method] = s
    groups: dict[tuple[str, ...], Any] = {}
    for by_method in owners.values():
        names = tuple(by_method)
        if names not in groups:
            groups[names] = parser.add_argument_group(f"settings of {', '.join(names)}")
        try:
            _add_setting(groups[names], by_method)
        except argparse.ArgumentError as error:
            raise ValueError(
                f"a setting of the method {', '.join(names)} has the name of another option: {error}"
            ) from None


def chosen_method(args: argparse.Namespace) -> Method:
    """The method that the options describe.

    Raises
    ------
    ValueError
        If a setting is not one of the method's, or out of range.
    """
    kind = method_class(args.method)
    own = {s.name for s in kind.settings()}
    given = {s.name for other in all_methods().values() for s in other.settings()}
    values = {name: getattr(args, name) for name in given if getattr(args, name) is not None}
    for name in sorted(set(values) - own):
        raise ValueError(f"--{name.replace('_', '-')}: the method {kind.name} has no such setting")
    return kind.from_settings(values)


def _add_setting(group: Any, by_method: dict[str, Setting]) -> None:
    s = next(iter(by_method.values()))
    text = _by_value({method: other.help for method, other in by_method.items()}, "{1}: {0}")
    if s.default is not None:
        text += f" (default {_by_value({method: other.default for method, other in by_method.items()}, '{0} for {1}')})"
    option: dict[str, Any] = {"default": None, "dest": s.name, "help": text.replace("%", "%%")}
    if s.kind is bool:
        option["action"] = argparse.BooleanOptionalAction
    else:
        choices = dict.fromkeys(choice for other in by_method.values() for choice in other.choices)
        names = f"{{{','.join(choices)}}}" if choices else "NAME"  # the method refuses any other
        option |= {"type": s.kind, "metavar": {int: "N", float: "X", str: names}[s.kind]}
    group.add_argument(f"--{s.name.replace('_', '-')}", **option)


def _by_value(values: dict[str, Any], form: str) -> str:
    """One value for all methods, or each with the methods that have it.

    Examples
    --------
    >>> _by_value({"a": 1, "b": 2, "c": 1}, "{0} for {1}")
    '1 for a, c; 2 for b'
    """
    methods: dict[Any, list[str]] = {}
    for method, value in values.items():
        methods.setdefault(value, []).append(method)
    if len(methods) == 1:
        return str(next(iter(methods)))
    return "; ".join(form.format(value, ", ".join(names)) for value, names in methods.items())
