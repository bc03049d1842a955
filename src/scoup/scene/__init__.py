"""The data: Gaussians, cameras, regions and sparse codes, as frozen dataclasses of tensors."""
