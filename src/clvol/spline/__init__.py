"""The function between the samples: coefficients on a device, and functions of them.

| module         | content                                                              | kernels              |
|----------------|----------------------------------------------------------------------|----------------------|
| `field`        | `Field`; `sample`, `resample`, `magnify` and `prefilter` of `clvol`  |                      |
| `warp`         | images through chains of transforms; series                          |                      |
| `resample`     | the function on another grid                                         | resample.cl          |
| `points`       | the function at points                                               | points.cl            |
| `sort`         | unordered points, sorted by brick                                    | sort.cl              |
| `minmax`       | the min-max pyramid of bounds                                        | minmax.cl            |
| `chain`        | chains of transforms                                                 | chain.cl, jacobian.cl |
| `prefilter`    | from samples to coefficients                                         | prefilter.cl         |
| `coefficients` | storage                                                              | coefficients.cl      |
| `build`        | `#define`s of kernels                                                | filter.cl, cell.cl … |
| `evaluator`    | direct taps or paired fetches, buffer or image                       | taps.cl, pairs.cl    |

Each imports only from those below it.
"""
