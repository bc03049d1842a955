"""The image encoder of MobileSAM: TinyViT, made of convolutions and of attention within windows.

Source: Wu et al., "TinyViT: Fast Pretraining Distillation for Small Vision Transformers", ECCV 2022, with the changes
of Zhang et al., "Faster Segment Anything", 2023: the last stage keeps the resolution, and SAM's neck follows.
Modules are named as in MobileSAM's checkpoint. Written here because transformers has no TinyViT, and timm needs
torchvision.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

DIMENSIONS = (64, 128, 160, 320)
DEPTHS = (2, 2, 6, 2)
HEADS = (2, 4, 5, 10)
WINDOWS = (7, 7, 14, 7)
STRIDES = (2, 2, 1)  # between the stages
NECK = 256


class TinyViT(nn.Module):
    """Images [B, 3, side, side], normalised -> embeddings [B, 256, side / 16, side / 16].

    Of the first stage, which consists of convolutions, heads and windows are not used.
    """

    def __init__(
        self,
        dimensions: Sequence[int] = DIMENSIONS,
        depths: Sequence[int] = DEPTHS,
        heads: Sequence[int] = HEADS,
        windows: Sequence[int] = WINDOWS,
        neck: int = NECK,
    ) -> None:
        super().__init__()
        first = dimensions[0]
        stem = _Convolution(3, first // 2, 3, 2), nn.GELU(), _Convolution(first // 2, first, 3, 2)
        self.patch_embed = nn.ModuleDict({"seq": nn.Sequential(*stem)})
        self.layers = nn.ModuleList()
        for stage, (size, depth) in enumerate(zip(dimensions, depths, strict=True)):
            blocks = [
                _Block(size, heads[stage], windows[stage]) if stage else _InvertedBottleneck(size)
                for _ in range(depth)
            ]
            parts: dict[str, nn.Module] = {"blocks": nn.Sequential(*blocks)}
            if stage < len(STRIDES):
                parts["downsample"] = _Downsample(size, dimensions[stage + 1], STRIDES[stage])
            self.layers.append(nn.ModuleDict(parts))
        self.neck = nn.Sequential(
            nn.Conv2d(dimensions[-1], neck, 1, bias=False),
            _ChannelNorm(neck),
            nn.Conv2d(neck, neck, 3, padding=1, bias=False),
            _ChannelNorm(neck),
        )

    def fold(self) -> None:
        """Make normalisations of batches part of their convolutions, and keep the channels of a pixel together: the
        same numbers up to rounding in less time. For evaluation, after weights are loaded."""
        for module in self.modules():
            if isinstance(module, _Convolution) and isinstance(module.bn, nn.BatchNorm2d):
                module.c, module.bn = fuse_conv_bn_eval(module.c, module.bn), nn.Identity()
        self.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]

    def forward(self, pixels: Tensor, **_: object) -> tuple[Tensor]:
        """Return a tuple that begins with the embeddings, as a vision encoder of transformers."""
        image = self.patch_embed["seq"](pixels)
        for layer in self.layers:
            assert isinstance(layer, nn.ModuleDict)
            for block in layer.values():
                image = block(image)
        return (self.neck(image),)


class _ChannelNorm(nn.LayerNorm):
    """Layer normalisation over the channels of images [B, C, H, W]."""

    def __init__(self, channels: int) -> None:
        super().__init__(channels, eps=1e-6)

    def forward(self, input: Tensor) -> Tensor:
        return super().forward(input.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class _Convolution(nn.Module):
    """A convolution and the normalisation after it."""

    def __init__(self, channels: int, out: int, size: int = 1, stride: int = 1, groups: int = 1) -> None:
        super().__init__()
        self.c = nn.Conv2d(channels, out, size, stride, size // 2, groups=groups, bias=False)
        self.bn: nn.BatchNorm2d | nn.Identity = nn.BatchNorm2d(out)

    def forward(self, image: Tensor) -> Tensor:
        return self.bn(self.c(image))


class _InvertedBottleneck(nn.Module):
    """MBConv of MobileNetV2 with four times as many channels within."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = 4 * channels
        self.conv1 = _Convolution(channels, inner)
        self.conv2 = _Convolution(inner, inner, 3, groups=inner)
        self.conv3 = _Convolution(inner, channels)

    def forward(self, image: Tensor) -> Tensor:
        inner = functional.gelu(self.conv2(functional.gelu(self.conv1(image))))
        return functional.gelu(image + self.conv3(inner))


class _Downsample(nn.Module):
    """The step from one stage to the next."""

    def __init__(self, channels: int, out: int, stride: int) -> None:
        super().__init__()
        self.conv1 = _Convolution(channels, out)
        self.conv2 = _Convolution(out, out, 3, stride, groups=out)
        self.conv3 = _Convolution(out, out)

    def forward(self, image: Tensor) -> Tensor:
        return self.conv3(functional.gelu(self.conv2(functional.gelu(self.conv1(image)))))


class _Block(nn.Module):
    """Attention within windows, a convolution of each channel, and a perceptron."""

    def __init__(self, channels: int, heads: int, window: int) -> None:
        super().__init__()
        self.window = window
        self.attn = _Attention(channels, heads, window)
        self.local_conv = _Convolution(channels, channels, 3, groups=channels)
        norm = nn.LayerNorm(channels)
        fc1, fc2 = nn.Linear(channels, 4 * channels), nn.Linear(4 * channels, channels)
        self.mlp = nn.ModuleDict({"norm": norm, "fc1": fc1, "fc2": fc2})

    def forward(self, image: Tensor) -> Tensor:
        image = self.local_conv(image + self._attend(image)).permute(0, 2, 3, 1)
        mlp = self.mlp
        image = image + mlp["fc2"](functional.gelu(mlp["fc1"](mlp["norm"](image))))
        return image.permute(0, 3, 1, 2)

    def _attend(self, image: Tensor) -> Tensor:
        batch, channels, height, width = image.shape
        window = self.window
        padded = functional.pad(image, (0, -width % window, 0, -height % window))
        rows, columns = padded.shape[2] // window, padded.shape[3] // window
        cut = padded.view(batch, channels, rows, window, columns, window).permute(0, 2, 4, 3, 5, 1)
        attended = self.attn(cut.reshape(-1, window * window, channels))
        whole = attended.view(batch, rows, columns, window, window, channels).permute(0, 5, 1, 3, 2, 4)
        return whole.reshape(padded.shape)[..., :height, :width]


class _Attention(nn.Module):
    """Attention between the pixels of a window, with a bias for each distance in x and y."""

    bias_numbers: Tensor

    def __init__(self, channels: int, heads: int, window: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(channels)
        self.qkv = nn.Linear(channels, 3 * channels)
        self.proj = nn.Linear(channels, channels)
        self.attention_biases = nn.Parameter(torch.zeros(heads, window * window))
        # In the checkpoint the distance (y, x) has the number window * y + x.
        y, x = torch.meshgrid(torch.arange(window), torch.arange(window), indexing="ij")
        y, x = y.flatten(), x.flatten()
        numbers = (y[:, None] - y).abs() * window + (x[:, None] - x).abs()
        self.register_buffer("bias_numbers", numbers, persistent=False)

    def forward(self, windows: Tensor) -> Tensor:
        count, pixels, channels = windows.shape
        qkv = self.qkv(self.norm(windows)).view(count, pixels, self.heads, -1).transpose(1, 2)
        query, key, value = qkv.chunk(3, dim=-1)
        bias = self.attention_biases[None, :, self.bias_numbers]
        mixed = functional.scaled_dot_product_attention(query, key, value, attn_mask=bias)
        return self.proj(mixed.transpose(1, 2).reshape(count, pixels, channels))
