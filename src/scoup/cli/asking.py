"""What verbs that ask a field share: opening it, its cameras, its text encoder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from scoup.cli.console import WritesCommon

if TYPE_CHECKING:
    from torch import Tensor

    from scoup.cameras import Camera, Cameras
    from scoup.field import LanguageField


@dataclass(frozen=True, kw_only=True)
class AsksField(WritesCommon):
    """Options of verbs that open a language field."""

    field: tyro.conf.Positional[Path]
    """The .scoup file."""
    gaussians: Path | None = None
    """The splat it belongs to, if it has moved."""

    def open_field(self) -> LanguageField:
        """The field, with its geometry checked where one is named."""
        from scoup.field import LanguageField
        from scoup.io import load_gaussians

        given = None if self.gaussians is None else load_gaussians(self.gaussians)
        field = LanguageField.load(self.field, given)
        _ = field.gaussians  # a missing or wrong geometry is told now, not after other work
        return field.to(self.device)


@dataclass(frozen=True, kw_only=True)
class AsksViews(AsksField):
    """Options of verbs that look through cameras."""

    camera: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Name of a camera (with or without extension), or all; repeat it for several. Default: the first."""
    scene: Path | None = None
    """Take the cameras from this scene folder or cameras file instead of those the field was built from."""
    scale: float = 1.0
    """Size of the pictures relative to the cameras' own."""

    def open_cameras(self, field: LanguageField) -> list[Camera]:
        """The cameras asked for.

        Raises:
            UnknownNameError: there is no camera of that name.
            InputError: there are no cameras.
        """
        from scoup.errors import InputError
        from scoup.io import load_cameras

        cameras: Cameras | None = field.cameras
        if self.scene is not None:
            cameras = load_cameras(self.scene, missing_images="keep")
        if cameras is None or not len(cameras):
            raise InputError(f"{self.field}: holds no cameras; name a scene with --scene")
        if not self.scale > 0:
            raise InputError(f"--scale must be above 0, got {self.scale}")
        cameras = cameras.scaled(self.scale) if self.scale != 1 else cameras
        if "all" in self.camera:
            return list(cameras)
        return [cameras[name] for name in self.camera] if self.camera else [cameras[0]]


@dataclass(frozen=True, kw_only=True)
class AsksText(AsksField):
    """Options of verbs that take words."""

    text: str | None = None
    """Where words become vectors: a table (.npz, .json, .safetensors), or a CLIP model by id or folder, or
    open_clip:ARCHITECTURE/PRETRAINED. Default: the model the field names."""

    def encode(self, field: LanguageField, phrases: Iterable[str]) -> tuple[Tensor, Tensor]:
        """Vectors of the phrases [Q, D] and of the canonical phrases [P, D].

        Raises:
            UnknownNameError: a word is not in the table; the nearest names are listed.
            InputError: the vectors have another size than the field's embeddings.
        """
        from scoup.errors import InputError
        from scoup.relevancy import CANONICAL_PHRASES
        from scoup.text import TextEncoder

        source = self.text or field.info.embedding_model
        if not source:
            raise InputError(f"{self.field}: names no embedding model; give a table or model with --text")
        with TextEncoder.open(source, device=self.device) as encoder:
            if encoder.dim != field.dim:
                raise InputError(
                    f"{source}: gives vectors of {encoder.dim} dimensions, {self.field} holds embeddings of "
                    f"{field.dim}; use the model the regions were encoded with ({field.info.embedding_model})"
                )
            return encoder.encode(list(phrases)), encoder.encode(list(CANONICAL_PHRASES))
