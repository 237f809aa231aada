"""The Hugging Face Hub: push datasets, checkpoints and results."""
