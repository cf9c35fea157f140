"""How kernels and their parts are compiled: parts to intermediate code alone, which kernels translate with their own.

Of its own, numba optimises each function together with all that it calls, and makes machine code of it, once more for
every level of calls; and what is called in several places it may expand in each of them. Here large parts stand once
in a kernel, as functions that only the kernel sees, so that arguments that are not used cost nothing.
"""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.types import unliteral


class _WithoutRun:
    """numba's code generator, but for what makes code ready to be run from Python."""

    def __init__(self, codegen: Any) -> None:
        self._whole = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)

    def set_env(self, name: str, env: Any) -> None:
        """Nothing: the environment is that of functions that raise exceptions or call Python."""


class PartLibrary(JITCodeLibrary):
    """Code of one function, to be linked into that of a kernel with those that it calls."""

    @property
    def codegen(self) -> Any:
        """The code generator."""
        return _WithoutRun(self._codegen)

    def finalize(self) -> None:
        """Leave it to the kernel to link, to optimise and to run the code."""
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "external":
                function.linkage = "linkonce_odr"
        self._shared_module, self._finalized = self._final_module, True


class KernelLibrary(JITCodeLibrary):
    """Code of a kernel with all of its parts, which are its own."""

    def add_linking_library(self, library: Any) -> None:
        """Add a part, and the parts that it calls."""
        if library not in self._linking_libraries:
            super().add_linking_library(library)
            for called in library._linking_libraries if isinstance(library, PartLibrary) else ():
                self.add_linking_library(called)

    def _optimize_final_module(self) -> None:
        """Once, without copies of loops that would be for long ones: here they run over a few actuators or elements."""
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        builder = self._codegen._pass_builder(loop_vectorize=False, slp_vectorize=False)
        builder._pto.loop_unrolling = builder._pto.loop_interleaving = False
        builder.getModulePassManager().run(self._final_module, builder)


class _Compiler(Compiler):
    """numba's compiler, with a library of another kind."""

    kind: type[JITCodeLibrary]

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        own = self.kind(targetctx.codegen(), self.kind.__name__) if library is None else library
        if library is None and self.kind is KernelLibrary:
            own.enable_object_caching()
        super().__init__(typingctx, targetctx, own, *rest)


class PartCompiler(_Compiler):
    """For what is expanded where it is called."""

    kind = PartLibrary


class KernelCompiler(_Compiler):
    """For kernels."""

    kind = KernelLibrary


def once_for_all_numbers(dispatcher: Any) -> None:
    """Have a function compiled once, not anew for every constant that it is called with."""
    given = getattr(dispatcher, "get_call_template", None)
    if given is None:  # a plain function, as where numba is told not to compile
        return

    def template(args: Any, kws: Any) -> Any:
        return given(tuple(map(unliteral, args)), {name: unliteral(value) for name, value in kws.items()})

    dispatcher.get_call_template = template
