"""A worker with another NumPy than ours, as far as it says."""


def dask_setup(worker):
    from importlib import import_module
    from typing import Any

    versions: Any = import_module("distributed.versions")
    installed = versions.version

    def version(name):
        return "1.0.0" if name == "numpy" else installed(name)

    versions.version = version
    versions._version_cached.cache_clear()
