"""Functions of volumes that are larger than memory: coefficients of one brick after the other, within a budget.

| module      | what it holds                                                          |
|-------------|------------------------------------------------------------------------|
| `field`     | `BrickedField`                                                         |
| `evaluate`  | grids, part by part                                                    |
| `store`     | reading bricks, and keeping them on the device                         |
| `residents` | who reads, who waits, and what is evicted                              |
| `bounds`    | what is known of the values in bricks                                  |
| `reduced`   | volumes with fewer samples, computed where they are read               |
| `budget`    | the longest edge of bricks for a budget                                |
| `grid`      | where bricks, their margins and their cells lie                        |

Each imports only from those below it.
"""
