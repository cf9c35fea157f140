"""How kernels and their parts are compiled: parts to intermediate code alone, which kernels translate with their own.

Of its own, numba optimises each function together with all that it calls, and makes machine code of it, once more for
every level of calls. Here each kernel links its parts once, as functions that only it sees, and optimises the whole.
"""

import gc
import sys
from functools import cache
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from llvmlite.binding import create_pass_builder, create_pipeline_tuning_options  # type: ignore[import-untyped]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import PassManager
from numba.core.typed_passes import (
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.types import Dispatcher, unliteral
from numba.core.untyped_passes import (
    DeadBranchPrune,
    FixupArgs,
    GenericRewrites,
    IRProcessing,
    ReconstructSSA,
    RewriteSemanticConstants,
    TranslateByteCode,
)

SECONDS = 15
"""Of one core, for the kernels of a kind of question: sets, equilibria and predictions, searches."""
PASSES = (
    *(TranslateByteCode, FixupArgs, IRProcessing, RewriteSemanticConstants, DeadBranchPrune, GenericRewrites),
    *(ReconstructSSA, NopythonTypeInference, PreLowerStripPhis, IRLegalization, NativeLowering, NoPythonBackend),
)
"""From Python's code to machine code."""


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

    def add_ir_module(self, module: Any) -> None:
        """Add the function's own code."""
        _say_what_is_there(module, self._codegen.target_data)
        _count_from_zero(module)
        super().add_ir_module(module)

    def _optimize_functions(self, module: Any) -> None:
        """Leave it to the kernel."""

    def finalize(self) -> None:
        """Leave it to the kernel to link, to optimise and to run the code."""
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "external":
                function.linkage = "linkonce_odr"
        self._shared_module, self._finalized = self._final_module, True


def _say_what_is_there(module: Any, sizes: Any) -> None:
    """Arguments that are references may be read before it is known that they need be: so before a loop, not within."""
    for function in module.functions:
        for argument in function.args:
            if isinstance(argument.type, ir.PointerType) and isinstance(argument.type.pointee, ir.LiteralStructType):
                argument.attributes.dereferenceable = argument.type.pointee.get_abi_size(sizes)


def _count_from_zero(module: Any) -> None:
    """Have no index count from an array's end: numba asks of each whether it is below 0, a tenth of all time here."""
    never = ir.Constant(ir.IntType(1), 0)
    for function in module.functions:
        for block in function.blocks:
            for one in block.instructions:
                if not isinstance(one, ir.SelectInstr) or not isinstance(one.operands[0], ir.ICMPInstr):
                    continue
                negative, wrapped, index = one.operands
                below = negative.op == "slt" and negative.operands[0] is index
                if below and getattr(wrapped, "opname", "") == "add" and wrapped.operands[0] is index:
                    one.operands = [never, wrapped, index]


class InlinedLibrary(PartLibrary):
    """Code of a function that becomes part of each that calls it."""

    def add_ir_module(self, module: Any) -> None:
        """Add the function's own code."""
        for function in module.functions:
            if not function.is_declaration:
                function.attributes.add("alwaysinline")
        super().add_ir_module(module)


class KernelLibrary(JITCodeLibrary):
    """Code of a kernel with all of its parts, which are its own."""

    def add_linking_library(self, library: Any) -> None:
        """Add a part, and the parts that it calls."""
        if library not in self._linking_libraries:
            super().add_linking_library(library)
            for called in library._linking_libraries if isinstance(library, PartLibrary) else ():
                self.add_linking_library(called)

    def _optimize_final_module(self) -> None:
        """Once and lightly, without what speeds up long loops: here they run over a few elements, and are written out
        where it is known over how many.

        LLVM's third level takes twice as long as the first, for code that is 5 % faster.

        The kernel stays apart from what calls it from Python: that writes what the kernel takes for unchanging.
        """
        for function in self._final_module.functions:
            if function.is_declaration:
                continue
            if function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
            elif function.linkage.name == "external":
                function.add_function_attribute("noinline")
        options = create_pipeline_tuning_options(speed_level=1)
        options.loop_unrolling = True
        options.loop_interleaving = options.loop_vectorization = options.slp_vectorization = False
        builder = create_pass_builder(self._codegen._tm, options)
        builder.getModulePassManager().run(self._final_module, builder)


class _TypesRemembered:
    """numba's rules of types, asked once what a function makes of given types: 200 answers serve 10,000 calls."""

    def __init__(self, rules: Any) -> None:
        self._rules = rules

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rules, name)

    def resolve_function_type(self, function: Any, given: Any, named: Any) -> Any:
        """The types that a call takes and gives."""
        if named or isinstance(function, Dispatcher) or not all(one.is_precise() for one in given):
            return self._rules.resolve_function_type(function, given, named)
        return _types_of_call(self._rules, function, tuple(given))


@cache
def _types_of_call(rules: Any, function: Any, given: tuple[Any, ...]) -> Any:
    return rules.resolve_function_type(function, given, {})


class PartCompiler(Compiler):
    """For parts: numba's compiler, with a library of another kind."""

    kind: type[JITCodeLibrary] = PartLibrary

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        own = self.kind(targetctx.codegen(), self.kind.__name__) if library is None else library
        super().__init__(_TypesRemembered(typingctx), targetctx, own, *rest)

    def define_pipelines(self) -> list[PassManager]:
        """numba's passes, without those for what no kernel has: closures, arrays as a whole, parallel loops."""
        passes = PassManager("kernels and their parts")
        for one in PASSES:
            passes.add_pass(one, one.__name__)
        passes.finalize()
        return [passes]


class InlinedCompiler(PartCompiler):
    """For parts that become part of what calls them."""

    kind = InlinedLibrary


class KernelCompiler(PartCompiler):
    """For kernels, with all parts that they call: many small objects, of which hardly any becomes garbage meanwhile."""

    kind = KernelLibrary

    def compile_extra(self, function: Any) -> Any:
        """Compile, while Python does not search for garbage: that would take a fifth of the time."""
        searches = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(function)
        finally:
            if searches:
                gc.enable()

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.state.library.enable_object_caching()
        _say_so()


@cache
def _say_so() -> None:
    """Tell who waits at a terminal what for, once."""
    if sys.stderr is not None and sys.stderr.isatty():
        print(f"torcharm compiles its engine, once: about {SECONDS} s", file=sys.stderr, flush=True)


def once_for_all_numbers(dispatcher: Any) -> None:
    """Have a function compiled once, not anew for every constant that it is called with."""
    given = getattr(dispatcher, "get_call_template", None)
    if given is None:  # a plain function, as where numba is told not to compile
        return

    def template(args: Any, kws: Any) -> Any:
        return given(tuple(map(unliteral, args)), {name: unliteral(value) for name, value in kws.items()})

    dispatcher.get_call_template = template
