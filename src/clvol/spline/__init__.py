"""The function between the samples: coefficients on a device, and what is computed from them.

| module         | what it holds                                                        | kernels              |
|----------------|----------------------------------------------------------------------|----------------------|
| `field`        | `Field`; `sample`, `resample`, `magnify` and `prefilter` of `clvol`  |                      |
| `warp`         | images through chains of transforms; series                          |                      |
| `resample`     | the function on another grid                                         | resample.cl          |
| `points`       | the function at points                                               | points.cl            |
| `sort`         | points in no order, sorted by brick                                  | sort.cl              |
| `minmax`       | the min-max pyramid of bounds                                        | minmax.cl            |
| `chain`        | chains of transforms                                                 | chain.cl, jacobian.cl |
| `prefilter`    | from samples to coefficients                                         | prefilter.cl         |
| `coefficients` | storage                                                              | coefficients.cl      |
| `build`        | what kernels need to know                                            | filter.cl, cell.cl … |
| `evaluator`    | direct taps or paired fetches, buffer or image                       | taps.cl, pairs.cl    |

Each imports only from those below it.
"""
