// Loops that each run at a limit of the device, for machine.py.

typedef float8 lanes;   // not float16: PoCL cannot compile it for every processor

// Reads and writes every element, to another place or (to == from) in place.
kernel void move(global const lanes *from, global lanes *to, const int length)
{
    const size_t first = (size_t)get_global_id(0) * length;
    for (int i = 0; i < length; ++i)
        to[first + i] = from[first + i] * 0.999f;
}

// Twelve chains that do not wait for one another: count * 12 * 8 multiply-adds.
#pragma OPENCL FP_CONTRACT ON
kernel void multiply_add(global lanes *result, const int count)
{
    lanes a[12];
    const lanes scale = 0.999f, offset = 1.0f + get_global_id(0);   // the sums stay away from zero: denormal numbers are slow
#pragma unroll
    for (int k = 0; k < 12; ++k)
        a[k] = offset + k;
    for (int i = 0; i < count; ++i)
#pragma unroll
        for (int k = 0; k < 12; ++k)
            a[k] = a[k] * scale + offset;
    lanes sum = a[0];
#pragma unroll
    for (int k = 1; k < 12; ++k)
        sum += a[k];
    result[get_global_id(0)] = sum;
}

// Vectors of four, like a row of taps, repeatedly from 16 KiB: count * 1024 loads.
kernel void load_rows(global const int4 *rows, global int4 *result, const int count)
{
    int4 a[8];
#pragma unroll
    for (int k = 0; k < 8; ++k)
        a[k] = 0;
    for (int i = 0; i < count; ++i)
        for (int j = 0; j < 1024; j += 8)
#pragma unroll
            for (int k = 0; k < 8; ++k)
                a[k] += rows[j + k];
    int4 sum = a[0];
#pragma unroll
    for (int k = 1; k < 8; ++k)
        sum += a[k];
    result[get_global_id(0)] = sum;
}
