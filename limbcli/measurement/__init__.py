"""What was measured: tables of levels, speeds and maps, pennation, records of instruments, their noise."""
