/* Compares stable_abi.h with CPython's own header: what is declared twice has to be the same for the
 * compiler, and its structs have the same layout. */
#define _object ours_object
#define PyObject ours_PyObject
#define PyTypeObject ours_PyTypeObject
#define _typeobject ours_typeobject
#define PyThreadState ours_PyThreadState
#define _ts ours_ts
#define Py_ssize_t ours_ssize_t
#define PyCFunction ours_PyCFunction
#define getter ours_getter
#define setter ours_setter
#define freefunc ours_freefunc
#define PyMethodDef ours_PyMethodDef
#define PyGetSetDef ours_PyGetSetDef
#define PyMemberDef ours_PyMemberDef
#define PyType_Slot ours_PyType_Slot
#define PyType_Spec ours_PyType_Spec
#define PyModuleDef_Base ours_PyModuleDef_Base
#define PyModuleDef ours_PyModuleDef
#define Py_buffer ours_Py_buffer
#define WHEEL_ABI_TYPES
#include "stable_abi.h"
#undef _object
#undef PyObject
#undef PyTypeObject
#undef _typeobject
#undef PyThreadState
#undef _ts
#undef Py_ssize_t
#undef PyCFunction
#undef getter
#undef setter
#undef freefunc
#undef PyMethodDef
#undef PyGetSetDef
#undef PyMemberDef
#undef PyType_Slot
#undef PyType_Spec
#undef PyModuleDef_Base
#undef PyModuleDef
#undef Py_buffer
#undef WHEEL_ABI_TYPES
#undef WHEEL_STABLE_ABI_H
/* The values of the constants as ours are; Python.h defines them again, and another value would be an error.
 */
enum { OURS_DEFAULT = Py_TPFLAGS_DEFAULT };
#undef Py_TPFLAGS_DEFAULT

#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <structmember.h>
#undef Py_TPFLAGS_DEFAULT
#include "stable_abi.h"

#define SAME(type, member)                                                                                   \
    _Static_assert(offsetof(ours_##type, member) == offsetof(type, member) &&                                \
                       sizeof(((ours_##type *)0)->member) == sizeof(((type *)0)->member),                    \
                   #type "." #member)
#define SIZE(type) _Static_assert(sizeof(ours_##type) == sizeof(type), #type)

SIZE(PyObject);
SAME(PyObject, ob_refcnt);
SAME(PyObject, ob_type);
SIZE(PyMethodDef);
SAME(PyMethodDef, ml_name);
SAME(PyMethodDef, ml_meth);
SAME(PyMethodDef, ml_flags);
SAME(PyMethodDef, ml_doc);
SIZE(PyGetSetDef);
SAME(PyGetSetDef, name);
SAME(PyGetSetDef, get);
SAME(PyGetSetDef, set);
SAME(PyGetSetDef, doc);
SAME(PyGetSetDef, closure);
SIZE(PyMemberDef);
SAME(PyMemberDef, name);
SAME(PyMemberDef, type);
SAME(PyMemberDef, offset);
SAME(PyMemberDef, flags);
SAME(PyMemberDef, doc);
SIZE(PyType_Slot);
SAME(PyType_Slot, slot);
SAME(PyType_Slot, pfunc);
SIZE(PyType_Spec);
SAME(PyType_Spec, name);
SAME(PyType_Spec, basicsize);
SAME(PyType_Spec, itemsize);
SAME(PyType_Spec, flags);
SAME(PyType_Spec, slots);
SIZE(PyModuleDef_Base);
SIZE(PyModuleDef);
SAME(PyModuleDef, m_name);
SAME(PyModuleDef, m_doc);
SAME(PyModuleDef, m_size);
SAME(PyModuleDef, m_methods);
SIZE(Py_buffer);
SAME(Py_buffer, buf);
SAME(Py_buffer, obj);
SAME(Py_buffer, len);
_Static_assert(sizeof(ours_ssize_t) == sizeof(Py_ssize_t), "Py_ssize_t");
_Static_assert((OURS_DEFAULT & ~(1UL << 18)) == 0, "Py_TPFLAGS_DEFAULT is that of the stable ABI");
