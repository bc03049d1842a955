"""The archive as a tool for language models."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import Any

from PIL import Image

from scoup.archive.archive import Archive
from scoup.base import InputError
from scoup.io import ANY_PIXELS
from scoup.models import LONGEST

MOST_FOUND = 200
"""Things, or with a least number of things scans, in one reply."""


def archive_tool(archive: Archive) -> Callable[..., dict[str, Any]]:
    """Return the tool over an archive, for ``scoup.view.mcp_server.make_server``."""

    def find_in_archive(
        text: str = "",
        where: str | None = None,
        at_least: int | None = None,
        limit: int = 20,
        image: str | None = None,
    ) -> dict[str, Any]:
        """Find things in many scans at once, the best first: the scan, place, box and score of each.

        `text` is a name ("fire extinguisher") or a phrase, as for `find`. `where` is a condition in SQL over the
        columns of the scans and things ("floor = 2 and gaussians > 100"). `at_least` keeps scans with so many
        things that answer. Positions are in the units of each scan; keys that end in `_metres` are in metres. In
        place of `text`, `image` is a picture of one object: a JPEG or PNG of up to 45 kB in base64. The score is then
        the cosine with it.
        """
        if not (image or text.strip()) or len(text) > LONGEST or not 1 <= limit <= MOST_FOUND:
            raise InputError(
                f"expected an image or a text of 1 to {LONGEST} characters, and a limit of 1 to {MOST_FOUND}"
            )
        if image is not None and (text.strip() or at_least is not None):
            raise InputError("`text` and `at_least` are for calls without `image`")
        if image is None:
            things = archive.find(text, where, limit, at_least)
        else:
            things = archive.find_image(_decoded(image), where, limit)
        records = [thing.to_dict() for thing in things]
        for record in records:
            del record["field"]  # a path of this machine
        return {"count": len(records), "things": records}

    return find_in_archive


def _decoded(picture: str) -> Image.Image:
    """Return a picture in base64 that a stranger has sent."""
    try:
        data = io.BytesIO(base64.b64decode(picture, validate=True))
        with Image.open(data, formats=("JPEG", "PNG")) as image:
            if image.width * image.height > ANY_PIXELS:
                raise ValueError("it claims more pixels than so few bytes can contain")
            image.load()
            return image
    except Exception as error:  # damaged images raise nearly everything inside Pillow
        raise InputError("`image` is not a JPEG or PNG; pass a picture in base64") from error
