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


class RoutineLibrary(PartLibrary):
    """The same, of a function that is not expanded where it is called."""

    def add_llvm_module(self, module: Any) -> None:
        """Add the function's own code."""
        for function in module.functions:
            if not function.is_declaration and not _is_expanded(function):
                function.add_function_attribute("noinline")
        super().add_llvm_module(module)


def _is_expanded(function: Any) -> bool:
    """Whether a function is marked as one that is expanded where it is called."""
    return any(b"alwaysinline" in attribute for attribute in function.attributes)


class KernelLibrary(JITCodeLibrary):
    """Code of a kernel with all of its parts, which are its own."""

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


class RoutineCompiler(_Compiler):
    """For what stands once in a kernel."""

    kind = RoutineLibrary


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
