"""The Python interface: one function a stage, and results that are dataclasses and tables.

Everything public is imported from `limbcli` itself, which opens these files when a name is first used.
The functions call the stages that the command line calls, with the same defaults, the same bounds and
the same lock on the output folder.
"""
