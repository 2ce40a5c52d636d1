/* Eight doubles, V8, in one instruction set: however many of its vectors that takes. */
#define V8 NAME(V8)
#define M8 NAME(M8)
#define PARTS (LANES / WIDTH)

typedef struct {
    VECTOR part[PARTS];
} V8;

/* Lanes chosen. */
typedef struct {
    MASK part[PARTS];
} M8;

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

/* a where chosen, else b. */
static INLINE V8 NAME(pick)(M8 chosen, V8 a, V8 b)
{
    V8 out;
    for (int i = 0; i < PARTS; ++i) out.part[i] = PICK(chosen.part[i], a.part[i], b.part[i]);
    return out;
}

static INLINE double NAME(total)(V8 a)
{
    double x[LANES];
    NAME(store)(x, a);
    return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]));
}
