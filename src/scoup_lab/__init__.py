"""The laboratory of SCOUP: protocols, baselines, simulated scenes, studies, measuring. ``scoup`` never imports it."""
