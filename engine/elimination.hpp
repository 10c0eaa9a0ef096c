// Unmeasured quantities eliminated by Householder reflections, for one tile of poses.

constexpr double FLAT = 1e-12, ROUNDED_AWAY = 1e-13;

struct Reflections {
    int u, m;
    double *vectors, *scales, *columns;  // (u, m), (u), (u, m): of it rows i <= j are the triangle

    const double* vector(int j, int i) const { return vectors + ((ptrdiff_t)j * m + i) * TILE; }
    double* column(int j, int i) const { return columns + ((ptrdiff_t)j * m + i) * TILE; }

    // what reflection j does to m rows
    void reflect(int j, double* part) const {
        vec weight[TV] = {};
        for (int i = j; i < m; i++)
            EACH weight[v] += load(vector(j, i) + v * LANES) * load(part + i * TILE + v * LANES);
        EACH weight[v] *= load(scales + j * TILE + v * LANES);
        for (int i = j; i < m; i++)
            EACH {
                double* const at = part + i * TILE + v * LANES;
                store(at, load(at) - load(vector(j, i) + v * LANES) * weight[v]);
            }
    }
    void apply(double* part) const {
        for (int j = 0; j < u; j++) reflect(j, part);
    }
    // what becomes of each of the m loops in the m - u that are left: (m - u, m)
    void leave(double* left) const {
        memset(left, 0, sizeof(double) * (m - u) * m * TILE);
        for (int i = 0; i < m - u; i++) {
            double* const part = left + (ptrdiff_t)i * m * TILE;
            EACH store(part + (u + i) * TILE + v * LANES, all(1.0));
            for (int j = u - 1; j >= 0; j--) reflect(j, part);
        }
    }
    void triangularise() const {
        for (int j = 0; j < u; j++) {
            vec square[TV] = {};
            for (int i = j; i < m; i++)
                EACH {
                    const vec a = load(column(j, i) + v * LANES);
                    store(vectors + ((ptrdiff_t)j * m + i) * TILE + v * LANES, a);
                    square[v] += a * a;
                }
            EACH {
                double* const head = vectors + ((ptrdiff_t)j * m + j) * TILE + v * LANES;
                const vec first = load(head), longer = first + with_sign_of(root(square[v]), first);
                store(head, longer);
                square[v] = longer * longer;
            }
            for (int i = j + 1; i < m; i++)
                EACH {
                    const vec a = load(vector(j, i) + v * LANES);
                    square[v] += a * a;
                }
            EACH {
                const ivec there = square[v] > all(0.0);
                const vec scale = all(2.0) / choose(there, square[v], all(1.0));
                store(scales + j * TILE + v * LANES, choose(there, scale, all(0.0)));
            }
            for (int c = j; c < u; c++) reflect(j, column(c, 0));
        }
    }
    // the steps of the unmeasured quantities from the first u rows, in their place
    void solve(double* right) const {
        for (int i = u - 1; i >= 0; i--)
            EACH {
                vec rest = load(right + i * TILE + v * LANES);
                for (int j = i + 1; j < u; j++)
                    rest -= load(column(j, i) + v * LANES) * load(right + j * TILE + v * LANES);
                const vec pivot = load(column(i, i) + v * LANES);
                const ivec flat = magnitude(pivot) < all(FLAT);
                const vec step = rest / choose(flat, all(1.0), pivot);
                store(right + i * TILE + v * LANES, choose(flat, all(0.0), step));
            }
    }
};

static Reflections reflections(int u, int m, Room& room) {
    return {u, m, room.rows(u * m), room.rows(u), room.rows(u * m)};
}

// A derivative of all loops in the r that are left, from the loops in which it is not always zero.
static void combine(const double* left, int r, int m, const View* derivative, Loops loops, double* out) {
    for (int i = 0; i < r; i++) {
        vec total[TV] = {};
        for (const int32_t* loop = loops.begin; loop != loops.end; loop++)
            EACH total[v] += load(left + ((ptrdiff_t)i * m + *loop) * TILE + v * LANES) * derivative[*loop][v];
        EACH store(out + i * TILE + v * LANES, total[v]);
    }
}

// The same; what only rounding left of it is made zero.
static void combine_without_rounding(const double* left, int r, int m, const View* derivative, Loops loops,
                                     double* out) {
    vec least[TV] = {};
    for (const int32_t* loop = loops.begin; loop != loops.end; loop++)
        EACH least[v] += derivative[*loop][v] * derivative[*loop][v];
    EACH least[v] = all(ROUNDED_AWAY) * root(least[v]);
    combine(left, r, m, derivative, loops, out);
    for (int i = 0; i < r; i++)
        EACH {
            double* const at = out + i * TILE + v * LANES;
            const vec a = load(at);
            store(at, choose(magnitude(a) < least[v], all(0.0), a));
        }
}
