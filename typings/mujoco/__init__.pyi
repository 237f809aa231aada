# MuJoCo's bindings are compiled and come without stubs; their names are checked by the tests.
from typing import Any

def __getattr__(name: str) -> Any: ...
