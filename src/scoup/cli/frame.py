"""scoup frame: the frame of a field in the world, kept in its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

from scoup.base import InputError
from scoup.cli.console import Console
from scoup.cli.info import lines_of
from scoup.cli.options import DeviceCommon, Direction, FieldFile, arg
from scoup.cli.query_options import TextOptions

if TYPE_CHECKING:
    from scoup.base import WorldFrame
    from scoup.query import Place, Thing

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
_LENGTHS = {"metres_per_unit": (), "longest_side": ("thing",), "distance": ("thing", "other")}
"""Lengths in metres, and the things that each is of."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Write into a field how long a unit of its scene is, which way is up, and where on Earth it lies.

    All verbs, the page, agents and exports then answer in metres and with that up. What is not passed stays. Without
    options, prints what the field has.
    """

    field: FieldFile
    """The .scoup file; it is changed."""
    metres_per_unit: float | None = None
    """Length of the scene's unit in metres."""
    thing: str | None = None
    """A thing whose size or distance is known, which measures the unit: a text or phrase, such as door."""
    longest_side: float | None = None
    """Longest side of the box of --thing in metres."""
    other: str | None = None
    """Another thing, whose distance from --thing is known."""
    distance: float | None = None
    """Distance between the positions of --thing and --other in metres."""
    up: Annotated[Axis | tuple[float, float, float] | None, arg(metavar="AXIS|X Y Z")] = None
    """The direction that is up: x, y, z, -x, -y, -z, or a vector. Default: estimated from the cameras."""
    north: Direction = None
    """The direction that is north."""
    origin: Annotated[tuple[float, float, float] | None, arg(metavar="LATITUDE LONGITUDE HEIGHT")] = None
    """Where on Earth 0, 0, 0 of the scene is: degrees, and metres above the ellipsoid (WGS 84)."""
    name: str | None = None
    """Name of the frame, such as the frame_id of ROS."""
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: DeviceCommon = DeviceCommon()

    def run(self, console: Console) -> None:
        from scoup.base import WorldFrame
        from scoup.field import read_facts, write_world

        before = WorldFrame.of_header(read_facts(self.field))
        up = self.up
        if isinstance(up, str):
            up = tuple(float(f"{up[:-1]}1") if axis == up[-1] else 0.0 for axis in "xyz")
        passed = {"up": up, "north": self.north, "origin": self.origin, "name": self.name}
        world = replace(before, **{name: value for name, value in passed.items() if value is not None})
        if (unit := self._metres_per_unit(console, world)) is not None:
            world = replace(world, metres_per_unit=unit)
        if world != before:
            write_world(self.field, world)
        for line in lines_of({**world.to_dict(), "name": world.name or None}):
            console.say(line)
        if world.metres_per_unit is None:
            console.say(
                "lengths are in scene units: pass --metres-per-unit, or --thing door --longest-side 2"
            )
        console.result({"field": self.field, "frame": world.to_dict()})

    def _metres_per_unit(self, console: Console, world: WorldFrame) -> float | None:
        """Return the length of the unit that was passed, or measured with the up of a frame; None without any."""
        from scoup.base import check_metres

        values = vars(self)
        lengths = [name for name in _LENGTHS if values[name] is not None]
        things = tuple(name for name in ("thing", "other") if values[name] is not None)
        for name in lengths:
            check_metres(values[name], f"--{name.replace('_', '-')}")
        if len(lengths) > 1 or things != (_LENGTHS[lengths[0]] if lengths else ()):
            raise InputError(
                "pass --metres-per-unit, or --thing with --longest-side, or --thing and --other with --distance"
            )
        if not things:
            return self.metres_per_unit
        field = self.opening.open(self.field, self.common.device).with_world(world)
        places = field.location(self.opening.question(field, [values[name] for name in things]))
        found = [_sure_thing(place) for place in places]
        across = (
            found[0].box.extent.max() if len(found) == 1 else (found[0].position - found[1].position).norm()
        )
        measured, length = float(across), values[lengths[0]]
        what = f"{' and '.join(place.answer.text for place in places)}: {lengths[0].replace('_', ' ')}"
        if not measured:
            raise InputError(f"{what} is 0 in the scene; name another thing")
        console.say(f"{what} {measured:.4g} scene units, {length:g} m")
        return length / measured


def _sure_thing(place: Place) -> Thing:
    if place.thing is None or place.answer.certainty == "doubtful":
        remedy = "name a thing that is surely there, or pass --metres-per-unit"
        raise InputError(f"{place.answer.text}: {place.answer.remark()}; {remedy}")
    return place.thing
