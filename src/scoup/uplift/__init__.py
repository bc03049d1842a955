"""Sparse code uplifting: region sums of all views, made once, and the algebra on them (method.md, stage 2).

Read the method in this order:

* ``rasterise``: ``region_sums`` rasterises every view once and keeps what each Gaussian contributes to each region;
* ``region_codes``: the embeddings of the regions become sparse codes;
* ``vote``, ``reweighting``: sums and codes of the regions become a code per Gaussian, in one round or several;
* ``things``, ``merging``: regions of many views that the same Gaussians contribute to become one instance;
* ``build``: all of these steps, from a splat, cameras and regions to a language field.

``RegionSums`` (``region_sums``) is what they share; ``storage`` is how it is kept.
"""
