"""Named tuples of many arrays, handed to kernels by their address.

Numba passes a named tuple to a compiled function as one argument for every number in it: the state of a
plan makes three hundred of them, copied at every call and carried through every pass of the optimiser,
which made up a third of the compilation and slowed planning down. A class marked `by_address` is
unpacked once, when Python calls a kernel, and handed on as a pointer. Its fields are read as before. They
cannot be set. Its arrays belong to the caller for as long as the kernel runs, so that no references to
them are counted; a kernel must not return one.
"""

from __future__ import annotations

import hashlib

from llvmlite import ir
from numba.core import cgutils, types
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


class Record(types.Type):
    """Numba's type of a named tuple that is handed on by its address."""

    def __init__(self, held: types.NamedTuple):
        self.held = held
        # Short: it becomes part of the name of every function that takes the record.
        digest = hashlib.sha256(str(held).encode()).hexdigest()[:16]
        super().__init__(f"{held.instance_class.__name__}_{digest}")

    @property
    def key(self):
        return self.held

    @property
    def instance_class(self) -> type:
        return self.held.instance_class

    def type_of(self, field: str) -> types.Type:
        """Numba's type of a field."""
        return self.held.types[self.held.fields.index(field)]


def by_address(cls: type) -> type:
    """Mark a NamedTuple class: kernels take it as a `Record`."""

    @typeof_impl.register(cls)
    def _typeof(value, context):
        return Record(types.NamedTuple([typeof_impl(field, context) for field in value], cls))

    return cls


@register_model(Record)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, record):
        super().__init__(manager, record, manager.lookup(record.held).get_value_type().as_pointer())


@unbox(Record)
def _unbox(record, obj, c):
    native = c.unbox(record.held, obj)
    pointer = cgutils.alloca_once_value(c.builder, native.value)

    def cleanup():
        if native.cleanup is not None:
            native.cleanup()
        c.context.nrt.decref(c.builder, record.held, native.value)  # numba does this for its own types

    return NativeValue(pointer, is_error=native.is_error, cleanup=cleanup)


@infer_getattr
class _Fields(AttributeTemplate):
    key = Record

    def generic_resolve(self, record, field):
        return record.type_of(field) if field in record.held.fields else None


@lower_getattr_generic(Record)
def _read(context, builder, record, pointer, field):
    number = record.held.fields.index(field)
    address = cgutils.gep_inbounds(builder, pointer, 0, number)
    if not isinstance(record.held.types[number], types.Array):
        return builder.load(address)
    # All of the array's description but its owner.
    value = ir.Constant(address.type.pointee, None)
    for member in range(2, len(address.type.pointee.elements)):
        loaded = builder.load(cgutils.gep_inbounds(builder, address, 0, member))
        value = builder.insert_value(value, loaded, member)
    return value
