"""Vision-language models as controllers, with the prompt of the paper, over any OpenAI-compatible
endpoint.
"""
