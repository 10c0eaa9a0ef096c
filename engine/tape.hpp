// Running a tape over one tile of poses.

// One row of poses in and out of the workspace; places beyond the last pose repeat it.
INLINE void fill_row(double* to, const double* from, int count) {
    if (count == TILE) {
        memcpy(to, from, sizeof(double) * TILE);  // a few vectors, no call
        return;
    }
    for (int p = 0; p < TILE; p++) to[p] = from[p < count ? p : count - 1];
}

INLINE void take_row(double* to, const double* from, int count) {
    if (count == TILE)
        memcpy(to, from, sizeof(double) * TILE);
    else
        for (int p = 0; p < count; p++) to[p] = from[p];
}

static void fill(double* to, const Rows& from, int rows, int pose, int count) {
    for (int i = 0; i < rows; i++) fill_row(to + i * TILE, from.at + i * from.row + pose, count);
}

static void write_numbers(const Program& program, double* workspace) {
    for (int i = 0; i < program.count; i++)
        for (int p = 0; p < TILE; p++) workspace[i * TILE + p] = program.numbers[i];
}

#define ARGUMENT(i) load(in##i + v * LANES)
#define OPEN(i) \
    const double* const in##i = workspace + instruction.in[i];
#define RESULT(i, value) store(workspace + instruction.out[i] + v * LANES, value)
#define UNARY(name, formula)                                \
    case name: {                                            \
        OPEN(0) EACH { const vec a = ARGUMENT(0); RESULT(0, formula); } \
        break;                                              \
    }
#define BINARY(name, formula)                                                              \
    case name: {                                                                           \
        OPEN(0) OPEN(1) EACH { const vec a = ARGUMENT(0), b = ARGUMENT(1); RESULT(0, formula); } \
        break;                                                                             \
    }
// libm, one pose after the other
#define EACH_POSE(name, formula)                                              \
    case name: {                                                              \
        OPEN(0) double* const out = workspace + instruction.out[0];           \
        for (int p = 0; p < TILE; p++) {                                      \
            const double a = in0[p];                                  \
            out[p] = formula;                                                 \
        }                                                                     \
        break;                                                                \
    }
#define EACH_POSE_2(name, formula)                                            \
    case name: {                                                              \
        OPEN(0) OPEN(1) double* const out = workspace + instruction.out[0];   \
        for (int p = 0; p < TILE; p++) {                                      \
            const double a = in0[p], b = in1[p];              \
            out[p] = formula;                                                 \
        }                                                                     \
        break;                                                                \
    }

static void run(const Program& program, double* workspace, int stage) {
    const Instruction* const last = program.instructions + program.ends[stage];
    for (const Instruction* at = program.instructions; at != last; at++) {
        const Instruction& instruction = *at;
        switch (instruction.code) {
            BINARY(ADD, a + b)
            BINARY(SUB, a - b)
            BINARY(MUL, a * b)
            BINARY(DIV, a / b)
            UNARY(NEG, -a)
            UNARY(SQUARE, a * a)
            UNARY(SQRT, root(a))
            UNARY(ABS, magnitude(a))
            UNARY(SIGN, choose((a == all(0.0)) | (a != a), a, with_sign_of(all(1.0), a)))
            EACH_POSE(TAN, tan(a))
            EACH_POSE(ARCSIN, asin(a))
            EACH_POSE(ARCCOS, acos(a))
            EACH_POSE(ARCTAN, atan(a))
            EACH_POSE(EXP, exp(a))
            EACH_POSE(LOG, log(a))
            EACH_POSE_2(POW, pow(a, b))
            EACH_POSE_2(ARCTAN2, atan2(a, b))
            EACH_POSE_2(HYPOT, hypot(a, b))
            case SINCOS: {
                OPEN(0) EACH {
                    vec sine, cosine;
                    sincos_of(ARGUMENT(0), &sine, &cosine);
                    RESULT(0, sine);
                    RESULT(1, cosine);
                }
                break;
            }
            case PLUS: {
                OPEN(0) OPEN(1) OPEN(2) OPEN(3)
                EACH RESULT(0, ARGUMENT(0) * ARGUMENT(1) + ARGUMENT(2) * ARGUMENT(3));
                break;
            }
            case MINUS: {
                OPEN(0) OPEN(1) OPEN(2) OPEN(3)
                EACH RESULT(0, ARGUMENT(0) * ARGUMENT(1) - ARGUMENT(2) * ARGUMENT(3));
                break;
            }
            case TURN: {
                OPEN(0) OPEN(1) OPEN(2) OPEN(3)
                EACH {
                    const vec a = ARGUMENT(0), b = ARGUMENT(1), c = ARGUMENT(2), d = ARGUMENT(3);
                    RESULT(0, a * c - b * d);
                    RESULT(1, a * d + b * c);
                }
                break;
            }
        }
    }
}
