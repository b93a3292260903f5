"""The Python interface: one function per stage, with results that are dataclasses and tables.

All public names are imported from `limbcli` itself, which loads these modules when a name is first used. The
functions call the same stages as the command line, with the same defaults, the same bounds and the same lock
on the output folder.
"""
