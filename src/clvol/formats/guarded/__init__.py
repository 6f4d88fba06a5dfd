"""Native readers (SimpleITK, tifffile's codecs, HDF5, ...) in a process of their own, within limits.

| module     | what                                                                       |
|------------|----------------------------------------------------------------------------|
| `limits`   | what reading a file may cost, in time and memory                           |
| `worker`   | our side: starts the processes, asks them, ends those that hang            |
| `child`    | the other side: reads files until its parent is gone                       |
| `messages` | what the child answers: JSON, and arrays of numbers; never a pickle        |

A file that crashes, hangs or floods a native library is a `FormatError`, and the caller lives. The process is no sandbox: code that
a hostile file makes a library run has the user's rights.
"""
