// Sums of products of whitened rows over poses: the normal equations, lower triangle, in blocks that
// stay in registers. Each sum runs in SUMS lanes over the poses in order, whatever the width. Rows of
// zeros, which a parameter of one coordinate has in the loops of the others, are left out: they add nothing.

// Rows in a block, as the registers of a width allow.
constexpr int BLOCK = LANES == 8 ? 4 : LANES == 4 ? 2 : 1;

INLINE int padded(int rows) { return (rows + 3) / 4 * 4; }

// The bit of a loop in a set of loops; the last one stands for all further loops together.
INLINE uint64_t bit(int loop) { return (uint64_t)1 << (loop < 63 ? loop : 63); }

// Whether a row has more than zeros; what is no number is no zero.
static bool some(const double* row, int poses) {
    for (int p = 0; p < poses; p += SUMS) {
        double size = 0.0;
        for (int s = 0; s < SUMS; s++) size += fabs(row[p + s]);
        if (!(size == 0.0)) return true;
    }
    return false;
}

// What the lanes of a sum come to.
INLINE double whole(const double* s) { return ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7])); }

// loops: those in which neither block has zeros alone; first: into sums that hold nothing yet; BY_LANE: whether each sum
// is SUMS lanes, or one number, which costs time for each block and saves memory
template <bool BY_LANE>
static void add_block(const double* const* left, const double* const* right, uint64_t loops, int r, int poses,
                      bool first, double* const* sums) {
    vec total[BLOCK][BLOCK][SV];
    for (int i = 0; i < BLOCK; i++)
        for (int j = 0; j < BLOCK; j++)
            for (int s = 0; s < SV; s++)
                total[i][j][s] = first || !BY_LANE ? all(0.0) : load(sums[i] + j * SUMS + s * LANES);
    for (int loop = 0; loop < r; loop++) {
        if (!(loops & bit(loop))) continue;
        for (int p = loop * PIECE; p < loop * PIECE + poses; p += SUMS)
            for (int s = 0; s < SV; s++) {
                vec b[BLOCK];
                for (int j = 0; j < BLOCK; j++) b[j] = load(right[j] + p + s * LANES);
                for (int i = 0; i < BLOCK; i++) {
                    const vec a = load(left[i] + p + s * LANES);
                    for (int j = 0; j < BLOCK; j++) total[i][j][s] += a * b[j];
                }
            }
    }
    for (int i = 0; i < BLOCK; i++)
        for (int j = 0; j < BLOCK; j++) {
            double lanes[SUMS] __attribute__((aligned(64)));
            double* const to = BY_LANE ? sums[i] + j * SUMS : lanes;
            for (int s = 0; s < SV; s++) store(to + s * LANES, total[i][j][s]);
            if (!BY_LANE) sums[i][j] = first ? whole(lanes) : sums[i][j] + whole(lanes);
        }
}

// Rows (r, PIECE) that enter products, and for each block of them the loops in which it has more than zeros.
struct Side {
    const double** rows;
    uint64_t* loops;
    int count;
};

static Side side(Room& room, int most) {
    const int rows = (padded(most) + TILE - 1) / TILE;
    return {(const double**)room.rows(rows), (uint64_t*)room.rows(rows), 0};
}

static void see(const Side& side, int r, int poses) {
    memset(side.loops, 0, sizeof(uint64_t) * padded(side.count));
    for (int i = 0; i < side.count; i++)
        for (int loop = 0; loop < r; loop++)
            if (some(side.rows[i] + (ptrdiff_t)loop * PIECE, poses)) side.loops[i / BLOCK] |= bit(loop);
}

// Sums over poses and loops of the products of all rows of both sides, at (left, right) of `sums`, whose rows are `stride`
// apart; lower: of these the lower triangle.
template <bool BY_LANE>
static void add_products(const Side& left, const Side& right, bool lower, int r, int poses, bool first, double* sums,
                         int stride) {
    for (int i = 0; i < left.count; i += BLOCK)
        for (int j = 0; j < (lower ? i + 1 : right.count); j += BLOCK) {
            const uint64_t loops = left.loops[i / BLOCK] & right.loops[j / BLOCK];
            if (!(loops || first)) continue;
            const double *a[BLOCK], *b[BLOCK];
            double* to[BLOCK];
            // rows beyond the last repeat it; what they add is never read
            for (int k = 0; k < BLOCK; k++) {
                a[k] = left.rows[i + k < left.count ? i + k : left.count - 1];
                b[k] = right.rows[j + k < right.count ? j + k : right.count - 1];
                to[k] = sums + ((ptrdiff_t)(i + k) * stride + j) * (BY_LANE ? SUMS : 1);
            }
            add_block<BY_LANE>(a, b, loops, r, poses, first, to);
        }
}

// Rows and sums of a piece; products: (most, PIECE), room for what the common columns give.
struct Summing {
    double *factors, *products, *sums;
    Side alone, members, others;
};

static Summing summing(const Program& program, int parameters, Room& room) {
    const Multiples& common = program.multiples;
    const size_t width = padded(parameters + 1);
    Summing to{};
    to.sums = room.doubles(width * width * SUMS);
    to.alone = side(room, parameters + 1);
    if (!common.commons) return to;
    to.factors = room.doubles((size_t)common.factors * PIECE);
    to.products = room.doubles((size_t)(parameters + 1) * PIECE);
    to.members = side(room, parameters + 1), to.others = side(room, parameters + 1);
    return to;
}

// Sums over loops of the products of two columns (r, PIECE), times a factor if there is one.
static void multiply(const double* a, const double* b, int r, int poses, double* to) {
    for (int p = 0; p < poses; p += LANES) {
        vec total = load(a + p) * load(b + p);
        for (int i = 1; i < r; i++) total += load(a + (ptrdiff_t)i * PIECE + p) * load(b + (ptrdiff_t)i * PIECE + p);
        store(to + p, total);
    }
}

// The members of common column c, as what they take of it.
static void take_members(const Multiples& common, int c, const double* factors, Side& to) {
    to.count = common.ends[c + 1] - common.ends[c];
    for (int i = 0; i < to.count; i++) to.rows[i] = factors + (ptrdiff_t)common.factor_of[common.ends[c] + i] * PIECE;
}

// Whether two common columns are multiplied by the same factors.
static bool same_factors(const Multiples& common, int c, int d) {
    const int count = common.ends[c + 1] - common.ends[c];
    return common.ends[d + 1] - common.ends[d] == count &&
           memcmp(common.factor_of + common.ends[c], common.factor_of + common.ends[d], sizeof(int32_t) * count) == 0;
}

// D_i = f_i C: the sum of D_i D_j over the loops is f_i times f_j C C', one product of common columns for all of theirs,
// and that with a row alone f_i times its product with C. piece: rows alone, common columns, E.
static void add_multiples(const Multiples& common, const double* piece, int r, int poses, bool first, Summing& to) {
    const ptrdiff_t row = (ptrdiff_t)r * PIECE;
    for (int c = 0; c < common.commons; c++) {
        const double* const column = piece + (common.alone + c) * row;
        double* const sums = to.sums + (ptrdiff_t)common.places[common.members[common.ends[c]]] * common.width;
        take_members(common, c, to.factors, to.members);
        see(to.members, 1, poses);
        to.others.count = to.alone.count;
        for (int i = 0; i < to.alone.count; i++) {
            multiply(column, to.alone.rows[i], r, poses, to.products + (ptrdiff_t)i * PIECE);
            to.others.rows[i] = to.products + (ptrdiff_t)i * PIECE;
        }
        see(to.others, 1, poses);
        add_products<false>(to.members, to.others, false, 1, poses, first, sums, common.width);
        for (int d = 0; d <= c; d++) {
            double* const both = to.products;
            multiply(column, piece + (common.alone + d) * row, r, poses, both);
            take_members(common, d, to.factors, to.others);
            for (int i = 0; i < to.others.count; i++) {
                double* const product = both + (ptrdiff_t)(i + 1) * PIECE;
                multiply(both, to.others.rows[i], 1, poses, product);
                to.others.rows[i] = product;
            }
            see(to.others, 1, poses);
            const int32_t at = common.places[common.members[common.ends[d]]];
            add_products<false>(to.members, to.others, same_factors(common, c, d), 1, poses, first, sums + at, common.width);
        }
    }
}

// The sums over the first `poses` of a piece of n + 1 rows, E the last; common: null where all rows are alone.
static void add_piece(const Multiples* common, const double* piece, int n, int r, int poses, bool first, Summing& to) {
    const ptrdiff_t row = (ptrdiff_t)r * PIECE;
    const int alone = common ? common->alone : n;
    for (int i = 0; i < alone; i++) to.alone.rows[i] = piece + i * row;
    to.alone.rows[alone] = piece + n * row;
    to.alone.count = alone + 1;
    see(to.alone, r, poses);
    if (!common) return add_products<true>(to.alone, to.alone, true, r, poses, first, to.sums, padded(n + 1));
    add_products<false>(to.alone, to.alone, true, r, poses, first, to.sums, common->width);
    add_multiples(*common, piece, r, poses, first, to);
}

// The lower triangle (width, width) of the sums of all parameters and E.
static void finish_sums(const Multiples* common, double* sums, int width, double* total) {
    for (int c = 0; common && c < common->commons; c++)
        for (int d = 0; d < c; d++) {
            if (!same_factors(*common, c, d)) continue;
            // f_i f_j C C' is f_j f_i C C'
            const int first = common->places[common->members[common->ends[c]]];
            double* const both = sums + (ptrdiff_t)first * common->width + common->places[common->members[common->ends[d]]];
            for (int i = 0; i < common->ends[c + 1] - common->ends[c]; i++)
                for (int j = 0; j < i; j++) both[(ptrdiff_t)j * common->width + i] = both[(ptrdiff_t)i * common->width + j];
        }
    for (int i = 0; i < width; i++)
        for (int j = 0; j <= i; j++) {
            double* const to = total + (ptrdiff_t)i * width + j;
            if (!common) {
                *to = whole(sums + ((ptrdiff_t)i * padded(width) + j) * SUMS);
                continue;
            }
            const ptrdiff_t a = common->places[i], b = common->places[j];
            *to = a > b ? sums[a * common->width + b] : sums[b * common->width + a];
        }
}
