"""The artefact: a language field over the Gaussians of one scene; its file, its parts, and what shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base.arguments import PATH, check_arguments
from scoup.base.errors import InputError
from scoup.field.artefact import FieldParts, read_field, write_field
from scoup.field.container import field_damage_named
from scoup.query.asking import Encoder
from scoup.query.methods import FieldQueries
from scoup.scene.codes import rows_of
from scoup.scene.gaussians import Gaussians, chosen_rows
from scoup.scene.things import ThingTable

if TYPE_CHECKING:
    from scoup.view.viewer import Viewer


class LanguageField(FieldQueries):
    """Sparse codes of every Gaussian at every level, their codebook, and the geometry they belong to, as one file.

    ``load`` reads one and ``scoup.build`` makes one; arguments of its own are those of ``CodedScene``.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> field.answer("kettle", "view_00").level in field.levels
        True
    """

    def __repr__(self) -> str:
        sizes = f"{self.n_atoms} atoms, {self.dim} dimensions of {self.embedding_model or 'an unnamed model'}"
        return f"LanguageField({len(self):,} Gaussians, levels {', '.join(self.levels)}, {sizes})"

    def _repr_html_(self) -> str:
        from scoup.query.field_card import field_card

        return field_card(self)

    def to(self, device: torch.device | str) -> LanguageField:
        """Return the field with its tensors, and its geometry if loaded, on a device; itself if it is there already."""
        place = torch.empty(0, device=device).device
        parts = [self.code_indices, self.code_weights, self.codebook]
        parts += [] if self._gaussians is None else [self._gaussians.means]
        if all(part.device == place for part in parts):
            return self
        moved = LanguageField(
            self.code_indices.to(device),
            self.code_weights.to(device),
            self.codebook.to(device),
            self.info,
            geometry_path=self.geometry_path,
            cameras=self.cameras,
            thing_table=None if self.thing_table is None else self.thing_table.to(device),
        )
        moved.path = self.path
        moved.keep_encoder_of(self)
        moved._gaussians = None if self._gaussians is None else self._gaussians.to(device)
        return moved

    def __getitem__(self, chosen: Tensor | ArrayLike | slice) -> LanguageField:
        """Return the field of some of the Gaussians, to be queried and saved as any other.

        Args:
            chosen: a boolean mask [N], indices [M] in any order, or a slice.

        Returns:
            A field with a geometry of its own, which ``save`` embeds in the file. It has no region sums: to add or
            remove views, build it again.

        Raises:
            InputError: there is no such Gaussian, or the geometry cannot be loaded.
        """
        rows = chosen_rows(chosen, len(self)).to(self.codebook.device)
        thing_table = None if self.thing_table is None else self.thing_table.rows(rows)
        gaussians = self.gaussians.select(chosen)
        return self._of(gaussians, rows_of(self.code_indices, rows), self.code_weights[rows], thing_table)

    def with_gaussians(self, gaussians: Gaussians) -> LanguageField:
        """Return a field with these codes on other Gaussians, one for one: after a move, new colours or fading.

        Args:
            gaussians: as many as before, in the same order.

        Returns:
            A field with a geometry of its own, as ``field[mask]`` has.

        Raises:
            InputError: there are more or fewer.
        """
        if len(gaussians) != len(self):
            raise InputError(f"{len(gaussians):,} Gaussians, but the field has codes of {len(self):,}")
        codes = self.code_indices, self.code_weights
        return self._of(gaussians.to(self.codebook.device), *codes, self.thing_table)

    def _of(
        self, gaussians: Gaussians, indices: Tensor, weights: Tensor, thing_table: ThingTable | None
    ) -> LanguageField:
        """Return a field of these Gaussians and their codes, made from this one."""
        provenance = {**self.info.provenance, "selected_from": self.fingerprint}
        info = replace(
            self.info, fingerprint=gaussians.fingerprint(), n_gaussians=len(gaussians), provenance=provenance
        )
        made = LanguageField(
            indices, weights, self.codebook, info, cameras=self.cameras, thing_table=thing_table
        )
        made.attach(gaussians, known=True)
        made.keep_encoder_of(self)
        return made

    def view(
        self,
        encoder: Encoder | None = None,
        words: Sequence[str] | None = None,
        most: int = 1_000_000,
        remote: bool = False,
        height: int = 640,
    ) -> Viewer:
        """Show the field in the browser, as `scoup view` does; in a notebook return the page itself.

        Args:
            encoder: see ``text_encoder``.
            words: what a click chooses from; by default everyday words, or the names of the table.
            most: Gaussians that the page shows at most; neighbours are merged until no more are left.
            remote: show rendered pictures only, for scenes that are too much for the browser.
            height: of the page in a notebook, in pixels.

        Returns:
            A viewer, open until its ``close`` or the end of the process; its ``address`` is that of the page.

        Raises:
            ScoupError: a package or the page is missing, or an encoder was given and cannot be opened.
            InputError: there is no geometry, or a number is out of range.
        """
        from scoup.view.viewer import open_viewer

        return open_viewer(self, encoder, words, most, remote, height)

    # ---- its file

    def save(
        self,
        path: str | Path,
        overwrite: bool = False,
        embed_geometry: bool | None = None,
        weight_bits: int = 16,
    ) -> None:
        """Write the field to one ``.scoup`` file (docs/formats.md), atomically.

        Args:
            path: the file.
            overwrite: replace what is there.
            embed_geometry: put the Gaussians into the file too. By default, only if they are in memory and the field
                names no file that holds them: such a field could not be queried after loading.
            weight_bits: 16 (float16) or 8 (255 steps of each code's largest weight).

        Raises:
            OutputExistsError: the file is there and ``overwrite`` is false.
            WriteError: the system refuses.
        """
        if embed_geometry is None:
            embed_geometry = self.geometry_path is None and self.has_geometry
        parts = FieldParts(
            self.code_indices,
            self.code_weights,
            self.codebook,
            self.info,
            self.gaussians if embed_geometry else None,
            self.geometry_path,
            self.cameras,
            self.thing_table,
        )
        write_field(parts, Path(path), overwrite, weight_bits)
        self.path = Path(path)

    @classmethod
    def load(cls, path: str | Path, gaussians: Gaussians | None = None) -> LanguageField:
        """Read a ``.scoup`` file.

        Args:
            path: the file.
            gaussians: its geometry; by default the one embedded or referenced, loaded when first needed.

        Raises:
            FileFormatError: the file is not a language field, or damaged.
            GeometryMismatchError: ``gaussians`` are not those it was built on.
        """
        optional = (Gaussians, type(None))
        check_arguments("LanguageField.load", path=(path, PATH), gaussians=(gaussians, optional))
        path = Path(path)
        parts = read_field(path)
        with field_damage_named(path):
            codes = parts.code_indices, parts.code_weights, parts.codebook
            known = {
                "geometry_path": parts.geometry_path,
                "cameras": parts.cameras,
                "thing_table": parts.things,
            }
            loaded = cls(*codes, parts.info, **known)
        loaded.path = path
        if gaussians is not None:
            loaded.attach(gaussians, f"{path} with the Gaussians given")
        elif parts.gaussians is not None:
            loaded.attach(parts.gaussians, f"{path}, the Gaussians embedded in it")
        return loaded
