// Kernel: the accuracy with which the device's linear sampler interpolates between two texels.

#include "base/platform.cl"

constant sampler_t linear_sampler = CLK_NORMALIZED_COORDS_FALSE | CLK_ADDRESS_CLAMP_TO_EDGE | CLK_FILTER_LINEAR;

// ramp: texels 0 and 1 along x. One position of those from 0 to 1, `step` apart, for each work-item.
kernel void sample_ramp(read_only image3d_t ramp, const float step, global float *values)
{
    const int i = get_global_id(0);
    values[i] = read_imagef(ramp, linear_sampler, (float4)(i * step + 0.5f, 0.5f, 0.5f, 0.0f)).x;
}
