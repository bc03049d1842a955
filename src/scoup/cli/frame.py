"""scoup frame: the frame of a field in the world, kept in its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from scoup.base import InputError
from scoup.cli.console import Console
from scoup.cli.options import DeviceCommon, Direction, FieldFile, arg
from scoup.cli.query_options import TextOptions

if TYPE_CHECKING:
    from scoup.query import LanguageField, Place
    from scoup.scene import WorldFrame

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]


@dataclass(frozen=True, kw_only=True)
class MetreOptions:
    """The length of the scene's unit, or a length that measures it."""

    metres_per_unit: float | None = None
    """Length of the scene's unit in metres."""
    thing: str | None = None
    """A thing whose size or distance is known: a text or phrase, such as door."""
    longest_side: float | None = None
    """Longest side of the box of --thing in metres."""
    other: str | None = None
    """Another thing, whose distance from --thing is known."""
    distance: float | None = None
    """Distance between the positions of --thing and --other in metres."""


@dataclass(frozen=True, kw_only=True)
class PlaceOptions:
    """Directions, place on Earth, and name."""

    up: Annotated[Axis | tuple[float, float, float] | None, arg(metavar="AXIS|X Y Z")] = None
    """The direction that is up: x, y, z, -x, -y, -z, or a vector. Default: estimated from the cameras."""
    north: Direction = None
    """The direction that is north."""
    origin: Annotated[tuple[float, float, float] | None, arg(metavar="LATITUDE LONGITUDE HEIGHT")] = None
    """Where on Earth 0, 0, 0 of the scene is: degrees, and metres above the ellipsoid (WGS 84)."""
    name: str | None = None
    """Name of the frame, such as the frame_id of ROS."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Write into a field how long a unit of its scene is, which way is up, and where on Earth it lies.

    All verbs, the page, agents and exports then answer in metres and with that up. What is not passed stays. Without
    options, prints what the field has.
    """

    field: FieldFile
    """The .scoup file; it is changed."""
    metre: Annotated[MetreOptions, arg(name="metre")] = MetreOptions()
    place: Annotated[PlaceOptions, arg(name="place")] = PlaceOptions()
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: DeviceCommon = DeviceCommon()

    def run(self, console: Console) -> None:
        """Measure, write and print."""
        from scoup.field import read_facts, write_world
        from scoup.scene import WorldFrame

        before = WorldFrame.of_dict(read_facts(self.field).get("frame", {}))
        world = replace(before, **self._place())
        world = replace(world, **self._metre(console, world))
        if world != before:
            write_world(self.field, world)
        for line in _lines(world):
            console.say(line)
        console.result({"field": self.field, "frame": world.to_dict()})

    def _place(self) -> dict[str, Any]:
        values = vars(self.place)
        passed = {name: value for name, value in values.items() if value is not None}
        if isinstance(up := passed.get("up"), str):
            passed["up"] = tuple(float(f"{up[:-1]}1") if name == up[-1] else 0.0 for name in "xyz")
        return passed

    def _metre(self, console: Console, world: WorldFrame) -> dict[str, float]:
        """Return the metres per unit that were passed, or measured with the up of a frame, if any."""
        from scoup.scene import check_metres

        metre = self.metre
        lengths = {
            "--metres-per-unit": metre.metres_per_unit,
            "--longest-side": metre.longest_side,
            "--distance": metre.distance,
        }
        passed = [(option, length) for option, length in lengths.items() if length is not None]
        for option, length in passed:
            check_metres(length, option)
        things = metre.thing is not None, metre.other is not None
        wanted = {"--longest-side": (True, False), "--distance": (True, True)}
        if len(passed) > 1 or things != wanted.get(passed[0][0] if passed else "", (False, False)):
            raise InputError(
                "pass --metres-per-unit, or --thing with --longest-side, or --thing and --other with --distance"
            )
        if not passed:
            return {}
        ((_, length),) = passed
        if metre.thing is None:
            return {"metres_per_unit": length}
        field = self.opening.open(self.field, self.common.device).with_world(world)
        place = self._located(field, metre.thing)
        assert place.box is not None
        measured, what = float(place.box.extent.max()), f"the longest side of {metre.thing}"
        if metre.other is not None:
            other = self._located(field, metre.other)
            assert place.position is not None
            assert other.position is not None
            measured = float((place.position - other.position).norm())
            what = f"the distance between {metre.thing} and {metre.other}"
        if not measured:
            raise InputError(f"{what} is 0 in the scene; name another thing")
        console.say(f"{what} is {measured:.4g} scene units and {length:g} m")
        return {"metres_per_unit": length / measured}

    def _located(self, field: LanguageField, text: str) -> Place:
        """Return the place of a text that surely is in the scene."""
        place = field.location(self.opening.question(field, text))
        if place.thing is None or place.answer.certainty == "doubtful":
            remedy = "name a thing that is surely there, or pass --metres-per-unit"
            raise InputError(f"{text}: {place.answer.remark()}; {remedy}")
        return place


def _lines(world: WorldFrame) -> list[str]:
    unit = world.metres_per_unit
    known = {
        "unit": "not known: answers are in scene units" if unit is None else f"{unit:.6g} m",
        "up": world.up or "estimated from the cameras",
        "north": world.north or "not known",
        "origin": world.origin or "not known",
        "name": world.name or "none",
    }
    return [
        f"{name}: {' '.join(f'{number:g}' for number in value) if isinstance(value, tuple) else value}"
        for name, value in known.items()
    ]
