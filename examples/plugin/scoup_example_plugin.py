"""A segmenter, an embedder with its texts, and a splat format, which SCOUP finds once this package is installed:

pip install examples/plugin
scoup extract SCENE --segmenter grid --embedder mean-colour
scoup convert point_cloud.ply points.csv
"""

import numpy as np
import torch
from PIL import ImageColor

import scoup
from scoup.base import atomic_file
from scoup.extract import Masks
from scoup.io import SplatFormat
from scoup.models import ModelEntry, ModelIdentity


class Grid:
    """Square cells: the methods of ``scoup.extract.Segmenter``."""

    cut_last = drop_hidden = False

    def to_dict(self):
        return {"segmenter": "grid"}

    def segment(self, image):
        rows, columns = (np.arange(length) / length for length in image.shape[:2])
        cells = {"s": 8, "m": 4, "l": 2}
        return {
            level: Masks.from_labels((rows * n).astype(int)[:, None] * n + (columns * n).astype(int))
            for level, n in cells.items()
        }


class MeanColour:
    """The mean colour of a crop: the methods of ``scoup.extract.interfaces.CropEmbedder``."""

    name, dim, side = "mean-colour", 3, 16

    def __init__(self, device):
        self.device = device

    def to_dict(self):
        return {"embedder": self.name}

    def embed(self, crops):
        return torch.nn.functional.normalize(crops.float().mean((1, 2)) + 1e-6, dim=1)


def open_texts(name, revision, device):
    """Colours by their English names; all other words are grey."""

    def encode(phrases):
        return (
            torch.tensor([ImageColor.getrgb(ImageColor.colormap.get(text, "grey")) for text in phrases])
            + 1e-6
        )

    return encode, ModelIdentity(name, "", "scoup-example-plugin 0.1.0")


def read_csv(path):
    rows = torch.from_numpy(np.loadtxt(path, np.float32, delimiter=",", ndmin=2))
    means, quats, scales, opacities, sh = rows.split([3, 4, 3, 1, 3], dim=1)
    return scoup.Gaussians(means, quats, scales, opacities[:, 0], sh[:, None])


def write_csv(gaussians, path, overwrite):
    columns = [
        gaussians.means,
        gaussians.quats,
        gaussians.scales,
        gaussians.opacities[:, None],
        gaussians.sh[:, 0],
    ]
    with atomic_file(path, overwrite) as stream:
        np.savetxt(stream, torch.cat(columns, dim=1).cpu().numpy(), delimiter=",")


GRID = ModelEntry("grid", lambda *options: Grid(), help="square cells", licence="Apache-2.0")
MEAN_COLOUR = ModelEntry(
    "mean-colour", lambda name, revision, device: MeanColour(device), open_texts, help="the mean colour"
)
CSV = SplatFormat("CSV", (".csv",), read_csv, write_csv, help="numbers as text, without SH")
