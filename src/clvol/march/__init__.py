"""Pictures: rays through a scene.

| module     | what it holds                                              | kernels                              |
|------------|------------------------------------------------------------|--------------------------------------|
| `renderer` | `Renderer`, `render`                                       |                                      |
| `launch`   | kernels on a device: fused, or in parts                    | draw.cl, split.cl                    |
| `frame`    | one picture made definite: its parameter block             | frame.cl (generated)                 |
| `planes`   | where rays are sampled                                     | camera.cl, plane.cl                  |

Each imports only from those below it.
"""
