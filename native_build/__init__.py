"""How the C of this project is compiled into shared libraries, for this machine and for others.

The only package that all others may import; it needs the standard library and a C compiler. ``compiler`` compiles,
``built_from`` tells whether what is there was built from the sources beside it.
"""
