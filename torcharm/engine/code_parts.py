"""Parts of kernels that are compiled as far as kernels need them: to intermediate code, not to machine code.

Of its own, numba optimises each function together with all that it calls, and makes machine code of it, once more for every
level of calls; what only kernels call is optimised and translated with these.
"""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _WithoutRun:
    """numba's code generator, but for what makes code ready to be run from Python."""

    def __init__(self, codegen: Any) -> None:
        self._whole = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)

    def set_env(self, name: str, env: Any) -> None:
        """Nothing: the environment is that of functions that raise exceptions or call Python."""


class PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code of one function and of those that it calls, to be linked into that of a kernel."""

    @property
    def codegen(self) -> Any:
        """The code generator."""
        return _WithoutRun(self._codegen)

    def _optimize_final_module(self) -> None:
        """Leave it to the kernel."""

    def _finalize_final_module(self) -> None:
        """Make the code ready to be linked, and none to be run."""
        self._finalize_dynamic_globals()
        self._finalized = True


class PartCompiler(Compiler):  # type: ignore[misc]
    """numba's compiler, with such a library."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        own = PartLibrary(targetctx.codegen(), "part") if library is None else library
        super().__init__(typingctx, targetctx, own, *rest)
