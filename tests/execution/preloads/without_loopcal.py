"""A worker that has no loopcal."""


def dask_setup(worker):
    import sys
    from importlib import import_module
    from importlib.metadata import PackageNotFoundError
    from typing import Any

    class Absent:
        def find_spec(self, name, path=None, target=None):
            if name.split(".")[0] == "loopcal":
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    def version(name):
        if name == "loopcal":
            raise PackageNotFoundError(name)
        return installed(name)

    versions: Any = import_module("distributed.versions")
    installed, versions.version = versions.version, version
    versions._version_cached.cache_clear()
    sys.meta_path.insert(0, Absent())
