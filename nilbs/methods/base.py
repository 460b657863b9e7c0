"""What a method is: one object whose fields are its settings, and which makes its field, its losses and its answers."""

import math
from collections.abc import Mapping
from dataclasses import Field as DataclassField
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args, get_type_hints

from nilbs.geometry.nearest_names import nearest_name

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from nilbs.characters.character import Character
    from nilbs.engine.answer import Engine
    from nilbs.engine.rest_state import RestState
    from nilbs.fields.field import Field, PosedField
    from nilbs.fields.objective import Objective, Term
    from nilbs.fields.occupancy_term import OccupancyTerm
    from nilbs.fields.scene import Scene

NOISE = 0.006  # of L: standard deviation of points near the surface, in training and in scores
MOST = 10**9  # of any setting that names no other bound
WIDEST = 4096  # units or layers of a network


def setting(
    default: Any, help: str, *, least: float = 0, most: float = MOST, choices: Mapping[str, str] | tuple[str, ...] = ()
) -> Any:
    """A field of a method's dataclass: its default, what it means, and which values it takes.

    The command line makes an option of it, the model file an entry, the documentation a row.
    """
    return field(default=default, metadata={"help": help, "least": least, "most": most, "choices": tuple(choices)})


@dataclass(frozen=True)
class Setting:
    """One setting of a method, as programs read it: its name, type (int, float, bool or str), default and bounds."""

    name: str
    kind: type
    default: Any
    help: str
    least: float
    most: float
    choices: tuple[str, ...]


@dataclass(frozen=True)
class Method:
    """A way to make a field of a character; lengths among the settings are fractions of L.

    A subclass is a frozen dataclass with a `name`, a `summary` and a method `field`. Defining it is enough: `fit`,
    `nilbs train --method NAME`, model files and scores find it by its name.

    Attributes
    ----------
    name, summary : str
        What commands, files and tables call it, and one line on what it is.
    mappings : mapping of str to str
        Ways from a posed point to its canonical point, where the method has a choice, and what each is.
    trained : bool
        Whether there is anything to train.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    mappings: ClassVar[Mapping[str, str]] = {}
    trained: ClassVar[bool] = False

    seed: int = setting(0, "seed of everything random; the same machine and threads then give the same model")

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "name" in cls.__dict__:
            if not hasattr(cls, "summary"):
                raise ValueError(f"the method {cls.name!r} needs a summary: one line on what it is")
            known = REGISTERED.get(cls.name, cls)
            places = {(kind.__module__, kind.__qualname__) for kind in (known, cls)}
            if len(places) > 1:  # a class may be defined again, as in a notebook
                raise ValueError(f"the name {cls.name!r} is that of {known.__module__}.{known.__qualname__}")
            REGISTERED[cls.name] = cls

    def __post_init__(self) -> None:
        for s in self.settings():
            value = getattr(self, s.name)
            if value is None and s.default is None:
                continue
            if type(value) not in ((int, float) if s.kind is float else (s.kind,)):
                raise ValueError(f"{s.name} must be of type {s.kind.__name__}, got {value!r}")
            if s.kind in (int, float) and not (math.isfinite(value) and s.least <= value <= s.most):
                raise ValueError(f"{s.name} must lie between {s.least:g} and {s.most:g}, got {value!r}")
            if s.choices and value not in s.choices:
                meant = nearest_name(str(value), s.choices)
                raise ValueError(f"{s.name} must be one of {', '.join(s.choices)}, got {value!r}{meant}")
        if not hasattr(self, "name"):
            raise ValueError(f"the method {type(self).__qualname__} needs a name")

    @classmethod
    def settings(cls) -> list[Setting]:
        """All settings of the method, in order.

        Raises
        ------
        ValueError
            If the class is no dataclass, or one of its fields is no `setting` of type int, float, bool or str.
        """
        # In place of a field, a dataclass keeps the default.
        if any(isinstance(value, DataclassField) for value in vars(cls).values()):
            raise ValueError(f"{cls.__qualname__} is no dataclass: write @dataclass(frozen=True) above the class")
        hints = get_type_hints(cls)
        found = []
        for f in fields(cls):
            kind = (get_args(hints[f.name]) or (hints[f.name],))[0]
            if not f.metadata or kind not in (int, float, bool, str):
                raise ValueError(
                    f"{cls.__qualname__}.{f.name} must be an int, float, bool or str, made by setting(default, help)"
                )
            found.append(Setting(f.name, kind, f.default, **f.metadata))
        return found

    @classmethod
    def from_settings(cls, values: Mapping[str, Any]) -> Self:
        """The method with settings by name.

        Raises
        ------
        ValueError
            If a name is unknown or a value has the wrong type or size.
        """
        known = {f.name for f in fields(cls)}
        if unknown := sorted(set(values) - known):
            meant = nearest_name(unknown[0], sorted(known))
            raise ValueError(
                f"the method {cls.name} has no setting {unknown[0]!r}{meant}; it has {', '.join(sorted(known))}"
            )
        return cls(**values)

    def resolved(self, character: "Character") -> Self:
        """The method with every None replaced by the value that fits the character."""
        return self

    def field(self, character: "Character") -> "Field":
        """An untrained field of the character."""
        raise NotImplementedError

    def rest(self, character: "Character") -> "RestState":
        """What is computed of the rest pose before any training, in arrays; here nothing."""
        from nilbs.engine.rest_state import RestState

        return RestState()

    def field_around(self, character: "Character", rest: "RestState") -> "Field":
        """An untrained field around what `rest` returned."""
        return self.field(character)

    def engine(self, character: "Character", rest: "RestState", mapping: str | None = None) -> "Engine | None":
        """What answers by a mapping without torch; None if the field must."""
        return None

    def posed(self, field: "Field", B: "Tensor", mapping: str | None = None, *, ghost: bool = True) -> "PosedField":
        """A field of this method in a pose (b, d+1, d+1) of the unit frame.

        Raises
        ------
        ValueError
            If the method has no such mapping.
        """
        self.check_mapping(mapping)
        return field.posed(B)

    def check_mapping(self, mapping: str | None) -> None:
        """Raise ValueError if the method has no such mapping; None stands for the default."""
        if mapping is not None and mapping not in self.mappings:
            choice = f"its mappings are {', '.join(self.mappings)}" if self.mappings else "it has no choice of them"
            meant = nearest_name(mapping, self.mappings)
            raise ValueError(f"the method {self.name} has no mapping {mapping!r}{meant}; {choice}")

    def check_state(self, character: "Character", state: "Mapping[str, np.ndarray]", rest: "RestState") -> None:
        """Check that arrays that a file held are those of a field of these settings: its parameters and grids.

        Raises
        ------
        KeyError, TypeError, ValueError
            Naming what does not fit.
        """
        if rest.arrays:
            raise ValueError(f"{next(iter(rest.arrays))}: the method {self.name} has no grids of the rest pose")
        if not self.trained and state:
            raise ValueError(f"{next(iter(state))}: the method {self.name} has no parameters")


REGISTERED: dict[str, type[Method]] = {}


@dataclass(frozen=True)
class TrainedMethod(Method):
    """A method whose field learns from labelled points of posed frames."""

    trained: ClassVar[bool] = True

    steps: int | None = setting(
        None, "training steps (default: 1000 and 100 more for each bone, at most 4000)", least=1
    )
    learning_rate: float = setting(1e-2, "largest rate of the one-cycle schedule", least=1e-12)
    poses_per_step: int = setting(64, "poses in the batch of each loss", least=1)
    points_per_pose: int = setting(128, "points of each of them", least=1)
    samples_per_frame: int = setting(20_000, "labelled points of each training frame", least=1)
    noise: float = setting(NOISE, "standard deviation of the labelled points near the surface; 0: uniform points")
    occupancy_loss: float = setting(1.0, "factor of the occupancy loss")

    def resolved(self, character: "Character") -> Self:
        """With the number of steps that fits the number of bones."""
        # More bones are harder to separate, and take longer.
        steps = min(1000 + 100 * len(character.skeleton.BE), 4000) if self.steps is None else self.steps
        return replace(self, steps=steps)

    @property
    def batch(self) -> dict[str, int]:
        """Size of a batch, as the losses take it."""
        return {"poses_per_step": self.poses_per_step, "points_per_pose": self.points_per_pose}

    def objective(self, field: "Field", scene: "Scene") -> "Objective":
        """What the training of a field minimises.

        Raises
        ------
        ValueError
            If every loss is off.
        """
        from nilbs.fields.objective import Objective

        occupancy = self.occupancy_term(field, scene) if self.occupancy_loss else None
        return Objective(occupancy, *self.terms(field, scene), seed=self.seed)

    def occupancy_term(self, field: "Field", scene: "Scene", **options: bool) -> "OccupancyTerm":
        """The loss that all methods share; options are those of `OccupancyTerm`."""
        from nilbs.fields.occupancy_term import OccupancyTerm

        labelled = scene.labelled_points(self.samples_per_frame, noise=self.noise)
        return OccupancyTerm(
            field.logit,
            scene.poses,
            labelled,
            poses_per_step=self.poses_per_step,
            points_per_pose=self.points_per_pose,
            factor=self.occupancy_loss,
            **options,
        )

    def terms(self, field: "Field", scene: "Scene") -> "list[Term]":
        """Further losses of the method itself."""
        return []


@dataclass(frozen=True)
class NetworkMethod(TrainedMethod):
    """A trained method whose field is a network of layers."""

    width: int = setting(96, "units of a hidden layer", least=1, most=WIDEST)
    depth: int = setting(5, "linear layers", least=2, most=WIDEST)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width**2 * self.depth > MOST:
            raise ValueError(f"depth {self.depth} and width {self.width} give more than {MOST:g} weights")

    def check_state(self, character: "Character", state: "Mapping[str, np.ndarray]", rest: "RestState") -> None:
        """As `Method.check_state`: nothing is built larger than what the file holds."""
        super().check_state(character, state, rest)
        self.check_layers(state)

    def layer_shapes(self, name: str, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """Shapes of the parameters of linear layers of these sizes, which are called `name`.0, `name`.1 and so on."""
        sizes = [inputs, *[self.width] * (self.depth - 1), outputs]
        shapes: dict[str, tuple[int, ...]] = {}
        for k, (i, o) in enumerate(pairwise(sizes)):
            shapes |= {f"{name}.{k}.weight": (o, i), f"{name}.{k}.bias": (o,)}
        return shapes

    def check_layers(self, state: "Mapping[str, np.ndarray]") -> None:
        """Raise ValueError if a file's tensors cannot hold layers of these sizes."""
        if self.width > max((max(a.shape, default=0) for a in state.values()), default=0):
            raise ValueError(f"no layer is as wide as its settings, {self.width}")
        if self.depth > len(state):
            raise ValueError(f"there are fewer layers than in its settings, {self.depth}")
        if self.width**2 * (self.depth - 2) > sum(a.size for a in state.values()):
            raise ValueError(f"it holds less than {self.depth} layers of width {self.width}")


def check_shapes(state: "Mapping[str, np.ndarray]", shapes: "Mapping[str, tuple[int, ...]]") -> None:
    """Raise ValueError if arrays are not floating-point numbers of these names and shapes."""
    for name in sorted({*state, *shapes}):
        if name not in state:
            raise ValueError(f"the parameters {name} are missing")
        if name not in shapes:
            raise ValueError(f"{name} are no parameters of a model with these settings")
        if state[name].shape != shapes[name] or state[name].dtype.kind != "f":
            found = f"{state[name].dtype} {state[name].shape}"
            raise ValueError(f"{name} must be {shapes[name]} floating-point numbers, got {found}")
