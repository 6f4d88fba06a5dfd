// Conversions that leave a number undefined give one that is no index. (The sanitizer sees those of single numbers alone.)

#ifndef HOSTILE
#define HOSTILE 0x7ffffff1
#endif

#define TO_INTS(lanes, type)                                                                          \
    static int##lanes __attribute__((overloadable, always_inline)) hostile_int##lanes(type##lanes v)  \
    {                                                                                                 \
        int##lanes result;                                                                            \
        for (int i = 0; i < lanes; ++i)                                                               \
            result[i] = v[i] > (type)-2147483648.5 && v[i] < (type)2147483648.0 ? (int)v[i] : HOSTILE; \
        return result;                                                                                \
    }
#define AS_IT_IS(to, from) \
    static to __attribute__((overloadable, always_inline)) hostile_##to(from v) { return __builtin_convertvector(v, to); }

TO_INTS(4, float) TO_INTS(4, double) TO_INTS(8, float) TO_INTS(8, double) TO_INTS(16, float)
AS_IT_IS(int4, long4) AS_IT_IS(int4, int4) AS_IT_IS(int8, int8) AS_IT_IS(int8, long8) AS_IT_IS(int16, int16)
AS_IT_IS(float4, int4) AS_IT_IS(float4, float4) AS_IT_IS(float4, double4)
AS_IT_IS(double4, int4) AS_IT_IS(double4, float4) AS_IT_IS(double4, double4)
AS_IT_IS(float8, int8) AS_IT_IS(float8, float8) AS_IT_IS(double8, int8) AS_IT_IS(double8, double8)
AS_IT_IS(float8, double8) AS_IT_IS(double8, float8) AS_IT_IS(float16, int16)
AS_IT_IS(long4, int4) AS_IT_IS(long8, int8)

#define hostile_scalar4 FOUR(SCALAR_TYPE)
#define FOUR(type) FOUR_(type)
#define FOUR_(type) hostile_##type##4
#define HOSTILE_(type) hostile_##type
#define __builtin_convertvector(v, type) HOSTILE_(type)(v)
