"""A motion, a metric and a policy of a third party."""

from .configuration_forward import ForwardConfig as ForwardConfig
