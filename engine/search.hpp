// Unmeasured quantities from the loops of each pose of a tile, the readings held: what
// loopcal/estimation/solve/searching.py says, in its order. A pose that has settled waits for the others.

constexpr int MOST = 40;
constexpr double SETTLED = 1e-6, FIRST = 1e-3, SOFTER = 0.1, HARDER = 10.0, STUCK = 1e8;

// Loops at some unmeasured quantities, in sds: f (m) and derivatives (u, m); their cost.
struct Weighted {
    double *f, *J, *cost;
};

static Weighted weighted(int u, int m, Room& room) { return {room.rows(m), room.rows(u * m), room.rows(1)}; }

static void weigh(const Linear& part, const Noise& noise, const double* weight, const Weighted& to) {
    const int m = part.program->loops;
    vec cost[TV] = {};
    for (int i = 0; i < m; i++)
        EACH {
            const vec w = load(weight + i * TILE + v * LANES), f = part.f[i][v] * w;
            cost[v] += f * f;
            store(to.f + i * TILE + v * LANES, f);
            for (int j = 0; j < noise.unmeasured_count; j++)
                store(to.J + ((ptrdiff_t)j * m + i) * TILE + v * LANES, part.J[noise.unmeasured[j] * m + i][v] * w);
        }
    EACH store(to.cost + v * LANES, cost[v]);
}

// 1 / the sd of each loop (m) that the sds of measured quantities give it. A loop of exact readings holds at least as
// well as any other of its pose; 1 where none has an sd.
static void weights(const Linear& part, const double* sds, const int32_t* own, double* weight) {
    const int m = part.program->loops, k = part.program->quantities;
    vec most[TV] = {};
    for (int i = 0; i < m; i++) {
        vec square[TV] = {};
        for (int q = 0; q < k; q++)
            EACH {
                const vec sd = load(sds + q * TILE + v * LANES);
                const vec spread = part.J[q * m + i][v] * choose(sd == all(INFINITY), all(0.0), sd);
                square[v] += spread * spread;
            }
        EACH {
            const vec spread = root(square[v]);
            const ivec usable = (spread > all(0.0)) & (spread < all(INFINITY));
            const vec w = choose(usable, all(1.0) / choose(usable, spread, all(1.0)), all(0.0));
            most[v] = choose(w > most[v], w, most[v]);
            store(weight + i * TILE + v * LANES, w);
        }
    }
    for (int i = 0; i < m; i++)
        EACH {
            double* const at = weight + i * TILE + v * LANES;
            const vec exact = choose(most[v] > all(0.0), most[v], all(1.0));
            vec w = choose(load(at) > all(0.0), load(at), exact);
            // what is missing says nothing
            if (own) w = choose(load(sds + own[i] * TILE + v * LANES) == all(INFINITY), all(0.0), w);
            store(at, w);
        }
}

// The damped step (u) of least squares; none where derivatives are no numbers. The longest of it.
static void damped_step(const Weighted& at, const double* damping, const Reflections& damped, double* step, vec* longest) {
    const int u = damped.u, m = damped.m - u;
    memset(damped.columns, 0, sizeof(double) * u * damped.m * TILE);
    for (int j = 0; j < u; j++) {
        vec square[TV] = {};
        for (int i = 0; i < m; i++)
            EACH {
                const vec a = load(at.J + ((ptrdiff_t)j * m + i) * TILE + v * LANES);
                store(damped.column(j, i) + v * LANES, a);
                square[v] += a * a;
            }
        EACH store(damped.column(j, m + j) + v * LANES, root(load(damping + v * LANES)) * root(square[v]));
    }
    damped.triangularise();
    memcpy(step, at.f, sizeof(double) * m * TILE);
    memset(step + m * TILE, 0, sizeof(double) * u * TILE);
    damped.apply(step);
    damped.solve(step);
    ivec finite[TV];
    EACH finite[v] = ~ivec{};
    EACH longest[v] = all(0.0);
    for (int j = 0; j < u; j++)
        EACH finite[v] &= magnitude(load(step + j * TILE + v * LANES)) < all(INFINITY);
    for (int j = 0; j < u; j++)
        EACH {
            double* const to = step + j * TILE + v * LANES;
            const vec one = choose(finite[v], -load(to), all(0.0)), size = magnitude(one);
            store(to, one);
            longest[v] = choose(size > longest[v], size, longest[v]);
        }
}

INLINE void take_where(const ivec* where, const double* from, int rows, double* to) {
    for (int i = 0; i < rows; i++)
        EACH {
            double* const at = to + i * TILE + v * LANES;
            store(at, choose(where[v], load(from + i * TILE + v * LANES), load(at)));
        }
}

// Rows of a tile that is searched.
struct Trial {
    double *start, *weight, *damping, *best, *step;  // (k), (m), (1), (u), (m + u)
    Weighted now, trial;
    Reflections damped;
};

static Trial trial_rows(const Program& program, const Noise& noise, Room& room) {
    const int k = program.inputs, m = program.loops, u = noise.unmeasured_count;
    return {room.rows(k),         room.rows(m),         room.rows(1), room.rows(u), room.rows(m + u),
            weighted(u, m, room), weighted(u, m, room), reflections(u, m + u, room)};
}

static void search_tile(const Search& job, int pose, int count, double* workspace, const Linear& part,
                        const double* sds, const Trial& to) {
    const Program& program = *job.program;
    const Noise& noise = *job.noise;
    const int k = program.inputs, m = program.loops, u = noise.unmeasured_count;
    double* const x = workspace + program.first;
    double *const start = to.start, *const weight = to.weight, *const damping = to.damping;
    double *const best = to.best, *const step = to.step;
    const Weighted &now = to.now, &trial = to.trial;
    const Reflections& damped = to.damped;
    fill(x, job.readings, k, pose, count);
    fill(start, job.corrections, k, pose, count);
    fill(x + k * TILE, job.known, program.known, pose, count);
    for (int i = 0; i < k * TILE; i += LANES) store(x + i, load(x + i) + load(start + i));
    run(program, workspace, 1);

    weights(part, sds, job.noise->own, weight);
    weigh(part, noise, weight, now);
    ivec active[TV];
    EACH active[v] = ~ivec{};
    EACH store(damping + v * LANES, all(FIRST));
    for (int j = 0; j < u; j++) memcpy(best + j * TILE, x + noise.unmeasured[j] * TILE, sizeof(double) * TILE);
    for (int iteration = 0; iteration < MOST; iteration++) {
        vec length[TV];
        damped_step(now, damping, damped, step, length);
        for (int i = 0; i < u * TILE; i += LANES) store(step + i, load(best + i) + load(step + i));
        for (int j = 0; j < u; j++) memcpy(x + noise.unmeasured[j] * TILE, step + j * TILE, sizeof(double) * TILE);
        run(program, workspace, 1);
        weigh(part, noise, weight, trial);
        ivec better[TV], left = {};
        EACH better[v] = active[v] & (load(trial.cost + v * LANES) <= load(now.cost + v * LANES));
        take_where(better, step, u, best);
        take_where(better, trial.f, m + u * m + 1, now.f);  // with J and cost, which follow
        EACH {
            const vec next = load(damping + v * LANES) * choose(better[v], all(SOFTER), all(HARDER));
            store(damping + v * LANES, next);
            active[v] &= ~((length[v] <= all(SETTLED)) | (next > all(STUCK)));
            left |= active[v];
        }
        if (!any(left)) break;
    }
    fill(x, job.readings, k, pose, count);
    for (int j = 0; j < u; j++) {
        const int q = noise.unmeasured[j];
        EACH {
            double* const at = best + j * TILE + v * LANES;
            store(at, load(at) - (load(x + q * TILE + v * LANES) + load(start + q * TILE + v * LANES)));
        }
        take_row(job.change + j * job.change_row + pose, best + j * TILE, count);
    }
}
