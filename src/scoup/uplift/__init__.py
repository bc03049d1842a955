"""Sparse code uplifting: region sums of all views, made once, and the algebra on them (method.md, stage 2).

* ``region_sums``: rasterise every view once and keep how much each Gaussian paints of each region;
* ``vote``: sums and codes of the regions to a code of each Gaussian, in one round or several;
* ``build``: all of it, from a splat, cameras and regions to a language field;
* ``update``: views added to, removed from or changed in a field whose sums are kept.

The method is read in ``region_sums``, ``vote``, ``reweighting``, ``build`` and ``update``. Behind them, ``rasterise``
is the loop over views, ``region_codes`` the embeddings and codes of the regions, ``storage`` how sums are kept.
"""
