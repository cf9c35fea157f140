"""Named tuples of arrays, which compiled functions take by reference.

Of its own, numba hands each number of each array of a tuple to each function that is called, some thousand for the
scratch of a search: most of the time of compilation. Here a tuple is a pointer to where its arrays are described, once
for a call from Python. Descriptions never change while kernels run, so they are read once and kept in registers.
"""

from hashlib import sha256
from typing import Any, TypeVar

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

T = TypeVar("T", bound=type)


class Reference(types.Type):
    """A named tuple of one class, whose fields are of these types: arrays, numbers or other references."""

    def __init__(self, kind: type, fields: tuple[types.Type, ...]) -> None:
        self.fields, self.names = fields, kind._fields  # type: ignore[attr-defined]
        whole = f"{kind.__module__}({', '.join(map(str, fields))})"  # names of functions hold those of their arguments
        super().__init__(f"{kind.__qualname__}-{sha256(whole.encode()).hexdigest()[:16]}")


def by_reference(kind: T) -> T:
    """Have named tuples of a class taken by reference."""

    def typed(value: Any, context: Any) -> Reference:
        return Reference(kind, tuple(typeof_impl(field, context) for field in value))

    typeof_impl.register(kind)(typed)
    return kind


@register_model(Reference)
class _Model(models.PrimitiveModel):
    """A pointer to the values of the fields, one behind the other, those of tuples within tuples among them."""

    def __init__(self, manager: Any, kind: Reference) -> None:
        values = [manager.lookup(field).get_value_type() for field in kind.fields]
        inside = [
            value.pointee if isinstance(field, Reference) else value
            for field, value in zip(kind.fields, values, strict=True)
        ]
        super().__init__(manager, kind, ir.LiteralStructType(inside).as_pointer())


@infer_getattr
class _Fields(AttributeTemplate):
    key = Reference

    def generic_resolve(self, kind: Reference, name: str) -> Any:  # type: ignore[override]
        return kind.fields[kind.names.index(name)] if name in kind.names else None


@lower_getattr_generic(Reference)  # type: ignore[untyped-decorator]
def _field(context: Any, builder: Any, kind: Reference, value: Any, name: str) -> Any:
    k = kind.names.index(name)
    place = cgutils.gep_inbounds(builder, value, 0, k)
    if isinstance(kind.fields[k], Reference):
        return place
    return builder.call(_reader(builder.module, context.get_value_type(kind.fields[k])), [place])


def _reader(module: Any, value: Any) -> Any:
    """A function that reads the value of a field, all of its numbers as what never changes."""
    name = f"torcharm.read.{value}"
    if name in module.globals:
        return module.globals[name]
    function = ir.Function(module, ir.FunctionType(value, [value.as_pointer()]), name)
    function.linkage = "linkonce_odr"
    function.attributes.add("alwaysinline")
    builder = ir.IRBuilder(function.append_basic_block())
    builder.ret(_read(builder, function.args[0], value))
    return function


def _read(builder: Any, place: Any, value: Any) -> Any:
    if isinstance(value, (ir.LiteralStructType, ir.ArrayType)):
        out = ir.Constant(value, ir.Undefined)
        for k in range(len(value)):
            part = value.elements[k] if isinstance(value, ir.LiteralStructType) else value.element
            out = builder.insert_value(out, _read(builder, cgutils.gep_inbounds(builder, place, 0, k), part), k)
        return out
    number = builder.load(place)
    number.set_metadata("invariant.load", builder.module.add_metadata([]))
    return number


@unbox(Reference)  # type: ignore[untyped-decorator]
def _unbox(kind: Reference, value: Any, c: Any) -> NativeValue:
    """Describe the arrays of a tuple from Python."""
    place = cgutils.alloca_once(c.builder, c.context.get_value_type(kind).pointee)
    failed = cgutils.alloca_once_value(c.builder, cgutils.false_bit)
    _describe(kind, value, place, failed, c)
    return NativeValue(place, is_error=c.builder.load(failed))


def _describe(kind: Reference, value: Any, place: Any, failed: Any, c: Any) -> None:
    for k, field in enumerate(kind.fields):
        item, there = c.pyapi.tuple_getitem(value, k), cgutils.gep_inbounds(c.builder, place, 0, k)
        if isinstance(field, Reference):
            _describe(field, item, there, failed, c)
            continue
        if isinstance(field, types.Array):
            code = c.pyapi.numba_array_adaptor(item, c.builder.bitcast(there, c.pyapi.voidptr))
            wrong = cgutils.is_not_null(c.builder, code)
        else:
            native = c.unbox(field, item)
            c.builder.store(native.value, there)
            wrong = native.is_error
        c.builder.store(c.builder.or_(c.builder.load(failed), wrong), failed)
