"""Compiled code on disk that is used only if it is whole: numba's files, with a digest at their end."""

import os
from contextlib import suppress
from hashlib import sha256
from typing import Any

from numba.core.caching import IndexDataCacheFile

_DIGEST = 32


class CheckedCacheFile(IndexDataCacheFile):
    """Code of one function; where its files are damaged there is none, and it is compiled and kept anew."""

    def load(self, key: Any) -> Any:
        """The code kept for a signature; None: there is none."""
        try:
            return super().load(key)
        except Exception:  # unpickling what is damaged raises whatever it comes upon
            return None

    def save(self, key: Any, data: Any) -> None:
        """Keep code, if there is room for it."""
        with suppress(OSError):
            super().save(key, data)

    def _load_index(self) -> Any:
        try:
            return super()._load_index()
        except Exception:  # as above: a damaged list is an empty one, and all is compiled and kept anew
            return {}

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        if not _is_whole(path):
            raise OSError(f"{path}: is damaged")
        return super()._load_data(name)  # unpickling ends before the digest

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(content + sha256(content).digest())


def guard(dispatcher: Any) -> None:
    """Have a compiled function keep its code in checked files; nothing is done where numba keeps it otherwise."""
    cache = getattr(dispatcher, "_cache", None)
    known = getattr(cache, "_cache_file", None)
    if cache is not None and type(known) is IndexDataCacheFile:
        impl = cache._impl
        cache._cache_file = CheckedCacheFile(cache.cache_path, impl.filename_base, impl.locator.get_source_stamp())


def _is_whole(path: str | os.PathLike[str]) -> bool:
    with open(path, "rb") as file:
        content = file.read()
    return sha256(content[:-_DIGEST]).digest() == content[-_DIGEST:]
