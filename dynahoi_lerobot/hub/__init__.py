"""The Hugging Face Hub: datasets, checkpoints and results are pushed to repositories that others load by name."""
