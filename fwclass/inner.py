"""What numba does for a function that only compiled code calls, and need not: machine code, and copies of variables.

A caller holds and optimises a copy of its own of all that it calls. So machine code of a function is made when
somebody asks for its address; kernels that kernels call are kept on disk as they were optimised, without it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any
from weakref import WeakSet

from fwclass import frontend

TRIED = "0.68."
"""Versions of numba whose insides are known; any other compiles its own way, which takes a third longer."""

_waiting: WeakSet[Any] = WeakSet()
"""Libraries of numba that are optimised and have no machine code yet."""


@cache
def change_numba(inner: Callable[[str], bool]) -> None:
    """Let numba work so. `inner` tells whether a function, by its module and name, is for compiled code alone."""
    import numba
    from numba.core import codegen, ir

    _with_own_copies(codegen.CPUCodeLibrary)
    if not numba.__version__.startswith(TRIED):
        return
    # Each block of a function that is written into another would get a copy of the scope, and of all names in it.
    ir.Scope.__deepcopy__ = lambda scope, memo: scope  # type: ignore[attr-defined,unused-ignore]
    frontend.shorten()
    _code_when_asked_for(codegen)
    _no_address_inside(inner)


def _with_own_copies(library_class: Any) -> None:
    """Let compiled code run its own copies of the functions that it calls.

    numba leaves those copies weak: a process that has compiled such a function by itself too runs that one's code,
    which was optimised in other surroundings. Where sums may be reordered, the last bits of a result would then depend
    on what else a process has compiled, and whether it has or only loaded it.
    """
    import llvmlite.binding as llvm

    optimise = getattr(library_class, "_optimize_final_module", None)
    if optimise is None:  # another numba: its own way, and the test of the bytes tells
        return

    def own(library: Any) -> None:
        for function in library._final_module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.linkonce_odr:
                function.linkage = llvm.Linkage.internal
        optimise(library)

    library_class._optimize_final_module = own


def _code_when_asked_for(codegen: Any) -> None:
    """Machine code is made for who asks for an address in it, or for the bytes."""
    library_class = codegen.JITCodeLibrary
    add, finish = codegen.JITCPUCodegen._add_module, library_class._finalize_specific
    bytes_of, address_of = library_class._get_compiled_object, library_class.get_pointer_to_function
    code_of = library_class.serialize_using_object_code

    def wait(library: Any) -> None:
        _waiting.add(library)
        names = (value.name for value in library._final_module.global_variables)
        if any(name.startswith(codegen.RuntimeLinker.PREFIX) for name in names):  # it calls itself, by its address
            make(library)

    def make(library: Any) -> None:
        library._ensure_finalized()
        if library in _waiting:
            _waiting.discard(library)
            add(library.codegen, library._final_module)
            finish(library)

    def get_compiled_object(library: Any) -> Any:
        make(library)
        return bytes_of(library)

    def get_pointer_to_function(library: Any, name: str) -> Any:
        make(library)
        return address_of(library, name)

    def serialize(library: Any) -> Any:
        return library.serialize_using_bitcode() if library in _waiting else code_of(library)

    codegen.JITCPUCodegen._add_module = lambda self, module: None
    library_class._finalize_specific = wait
    library_class._get_compiled_object = get_compiled_object
    library_class.get_pointer_to_function = get_pointer_to_function
    library_class.serialize_using_object_code = serialize


def _no_address_inside(inner: Callable[[str], bool]) -> None:
    """No address is asked for of a function that is `inner`, and nothing is written for Python to call it."""
    from numba import _dynfunc
    from numba.core.codegen import JITCPUCodegen
    from numba.core.cpu import CPUContext
    from numba.core.environment import lookup_environment
    from numba.core.runtime import rtsys

    executable, set_env = CPUContext.get_executable, JITCPUCodegen.set_env
    wrapper = CPUContext.create_cpython_wrapper

    def get_executable(context: Any, library: Any, fndesc: Any, env: Any) -> Any:
        if inner(f"{fndesc.modname}.{fndesc.qualname}"):  # what is called by a name only; nothing jumps there
            library._ensure_finalized()
            nowhere = rtsys.library.get_pointer_to_function("nrt_unresolved_abort")
            module, name = fndesc.lookup_module(), fndesc.qualname.split(".")[-1]
            return _dynfunc.make_function(module, name, "for compiled code alone", nowhere, env, (library,))
        function = executable(context, library, fndesc, env)
        for value in library._final_module.global_variables:
            there = lookup_environment(value.name)
            if there is not None:
                library.codegen.set_env(value.name, there)
        return function

    def set_where_it_is(codegen: Any, name: str, env: Any) -> None:
        if codegen._engine.get_global_value_address(name):
            set_env(codegen, name, env)

    def create_cpython_wrapper(context: Any, library: Any, fndesc: Any, *words: Any, **named: Any) -> None:
        if not inner(f"{fndesc.modname}.{fndesc.qualname}"):
            wrapper(context, library, fndesc, *words, **named)

    CPUContext.get_executable = get_executable
    CPUContext.create_cpython_wrapper = create_cpython_wrapper
    JITCPUCodegen.set_env = set_where_it_is


def kept_from_python(dispatcher: Any) -> Callable[[Any], None]:
    """The `add_overload` of `dispatcher`, that gives Python nothing without machine code."""
    add = dispatcher.add_overload

    def add_overload(result: Any) -> None:
        if result.library in _waiting:
            dispatcher.overloads[tuple(result.signature.args)] = result
        else:
            add(result)

    return add_overload


def forget(dispatcher: Any, signature: Any) -> None:
    """Python asks for what only compiled code has called so far: it is compiled again, or read from its own file."""
    from numba.core.sigutils import normalize_signature

    types = tuple(normalize_signature(signature)[0])
    if types in dispatcher.overloads and dispatcher.overloads[types].library in _waiting:
        del dispatcher.overloads[types]
