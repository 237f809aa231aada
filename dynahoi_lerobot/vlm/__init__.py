"""Vision-language models as controllers: the paper's prompt protocol over any OpenAI-compatible endpoint."""
