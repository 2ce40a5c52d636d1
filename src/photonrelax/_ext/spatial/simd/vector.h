/* Eight doubles, V8, and sixteen floats, F16, in one instruction set: however many of its vectors
 * that takes. */
#define V8 NAME(V8)
#define M8 NAME(M8)
#define PARTS (LANES / WIDTH)

typedef struct {
    VECTOR part[PARTS];
} V8;

/* SimdKernels chosen. */
typedef struct {
    MASK part[PARTS];
} M8;

#define F16 NAME(F16)
#define FM16 NAME(FM16)
#define F_PARTS (BLOCK / F_WIDTH)

typedef struct {
    F_VECTOR part[F_PARTS];
} F16;

typedef struct {
    F_MASK part[F_PARTS];
} FM16;

static INLINE V8 NAME(all)(double x)
{
    V8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = SET(x);
    return out;
}

static INLINE V8 NAME(load)(const double *x)
{
    V8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = LOAD(x + WIDTH * i);
    return out;
}

static INLINE void NAME(store)(double *x, V8 a)
{
    for (int i = 0; i < PARTS; ++i) STORE(x + WIDTH * i, a.part[i]);
}

/* Store where a line of the cache starts, past the cache. */
static INLINE void NAME(stream)(double *x, V8 a)
{
    for (int i = 0; i < PARTS; ++i) STREAM(x + WIDTH * i, a.part[i]);
}

static INLINE void NAME(store_rounded)(float *x, V8 a)
{
    for (int i = 0; i < PARTS; ++i) STORE_ROUNDED(x + WIDTH * i, a.part[i]);
}

/* Eight ids, as the bits of doubles. */
static INLINE V8 NAME(load_ids)(const int64_t *x)
{
    V8 out;
    memcpy(&out, x, sizeof out);
    return out;
}

#define EACH(name, operation, type)                                                      \
    static INLINE type NAME(name)(V8 a, V8 b)                                            \
    {                                                                                    \
        type out;                                                                        \
        for (int i = 0; i < PARTS; ++i) out.part[i] = operation(a.part[i], b.part[i]);   \
        return out;                                                                      \
    }
EACH(add, ADD, V8)
EACH(sub, SUB, V8)
EACH(mul, MUL, V8)
EACH(quotient, DIV, V8)
EACH(greater, MAX, V8)
EACH(lesser, MIN, V8)
EACH(at_most, AT_MOST, M8)
#undef EACH

static INLINE V8 NAME(root)(V8 a)
{
    V8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = SQRT(a.part[i]);
    return out;
}

static INLINE M8 NAME(both)(M8 a, M8 b)
{
    M8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = BOTH(a.part[i], b.part[i]);
    return out;
}

static INLINE unsigned NAME(bits)(M8 a)
{
    unsigned out = 0;
    for (int i = 0; i < PARTS; ++i) out |= BITS(a.part[i]) << (WIDTH * i);
    return out;
}

static INLINE M8 NAME(chosen)(unsigned bits)
{
    M8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = CHOOSE(bits >> (WIDTH * i) & ((1u << WIDTH) - 1));
    return out;
}

/* a where chosen, else b. */
static INLINE V8 NAME(pick)(M8 chosen, V8 a, V8 b)
{
    V8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = PICK(chosen.part[i], a.part[i], b.part[i]);
    return out;
}

/* The sum of all: upper halves are added to lower ones, whatever the size of vectors. */
static INLINE double NAME(total)(V8 a)
{
    for (int n = PARTS / 2; n > 0; n /= 2)
        for (int i = 0; i < n; ++i) a.part[i] = ADD(a.part[i], a.part[i + n]);
    return TOTAL(a.part[0]);
}

static INLINE F16 NAME(f_all)(float x)
{
    F16 out;
    for (int i = 0; i < F_PARTS; ++i) out.part[i] = F_SET(x);
    return out;
}

static INLINE F16 NAME(f_load)(const float *x)
{
    F16 out;
    for (int i = 0; i < F_PARTS; ++i) out.part[i] = F_LOAD(x + F_WIDTH * i);
    return out;
}

static INLINE void NAME(f_store)(float *x, F16 a)
{
    for (int i = 0; i < F_PARTS; ++i) F_STORE(x + F_WIDTH * i, a.part[i]);
}

#define EACH(name, operation, type)                                                      \
    static INLINE type NAME(name)(F16 a, F16 b)                                          \
    {                                                                                    \
        type out;                                                                        \
        for (int i = 0; i < F_PARTS; ++i) out.part[i] = operation(a.part[i], b.part[i]); \
        return out;                                                                      \
    }
EACH(f_add, F_ADD, F16)
EACH(f_sub, F_SUB, F16)
EACH(f_mul, F_MUL, F16)
EACH(f_greater, F_MAX, F16)
EACH(f_lesser, F_MIN, F16)
EACH(f_at_most, F_AT_MOST, FM16)
#undef EACH

static INLINE FM16 NAME(f_both)(FM16 a, FM16 b)
{
    FM16 out;
    for (int i = 0; i < F_PARTS; ++i) out.part[i] = F_BOTH(a.part[i], b.part[i]);
    return out;
}

static INLINE F16 NAME(f_pick)(FM16 chosen, F16 a, F16 b)
{
    F16 out;
    for (int i = 0; i < F_PARTS; ++i) out.part[i] = F_PICK(chosen.part[i], a.part[i], b.part[i]);
    return out;
}

/* a + b where chosen, else a. */
static INLINE F16 NAME(f_add_where)(FM16 chosen, F16 a, F16 b)
{
    F16 out;
    for (int i = 0; i < F_PARTS; ++i)
        out.part[i] = F_ADD_WHERE(chosen.part[i], a.part[i], b.part[i]);
    return out;
}

static INLINE unsigned NAME(f_bits)(FM16 a)
{
    unsigned out = 0;
    for (int i = 0; i < F_PARTS; ++i) out |= F_BITS(a.part[i]) << (F_WIDTH * i);
    return out;
}

static INLINE void NAME(f_store_integers)(int32_t *x, F16 a)
{
    for (int i = 0; i < F_PARTS; ++i) F_STORE_INTEGERS(x + F_WIDTH * i, a.part[i]);
}
