"""One run recorded and read back: rows through shared memory to a process that writes .rrd or .mcap (RECORDING.md).

May import: `core`. `recording.py` is the run's side, `recorder.py` the process, `reader.py`
reads a recording back. What viewers show of it besides the data is an add-on's (`viewing.py`).
To add a format: a class with the methods of `McapFile`, in `RunFile` of `run_files.py`.
"""
