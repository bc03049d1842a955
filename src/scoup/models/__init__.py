"""What gives embeddings and masks: CLIP, SigLIP, SAM, word tables. Only this room knows transformers and open_clip."""
