"""The files of recordings, one module per format; all of them read what is left of damaged files.

The readers of rosbags trust the index at the end of a file, and read nothing where it is missing
or wrong. These look at the records themselves; rosbags provides message types and conversion.
"""
