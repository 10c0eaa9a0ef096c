// Rows of TILE poses in a workspace.

// Room for them, one after the other. Without a workspace it only counts: the code that lays out a job says so how much
// the job needs.
struct Room {
    double* workspace;
    size_t used, limit;  // doubles
    double* doubles(size_t count) {
        double* const begin = workspace ? workspace + used : nullptr;
        used += count;
        if (used > limit) __builtin_trap();
        return begin;
    }
    double* rows(int count) { return doubles((size_t)count * TILE); }
};

// One row, somewhere.
struct View {
    const double* at;
    vec operator[](int v) const { return load(at + v * LANES); }
};

static View* views(Room& room, int count) {
    const int rows = (int)(((size_t)count * sizeof(View) + sizeof(double) * TILE - 1) / (sizeof(double) * TILE));
    return (View*)room.rows(rows);
}

// Some of the loops.
struct Loops {
    const int32_t *begin, *end;
};

// What a tape gives, as views: f (m), J (k, m), D (n, m) of n parameters, or of what `columns` names in their place.
struct Linear {
    const View *f, *J, *D;
    const Program* program;
    const int32_t* columns;
    int n;

    // those in which the derivative by a quantity, or by a parameter, is not always zero
    Loops of_quantity(int q) const { return of_column(q); }
    Loops of_parameter(int p) const { return of_column(program->quantities + (columns ? columns[p] : p)); }
    Loops of_column(int c) const { return {program->loops_of + program->ends_of[c], program->loops_of + program->ends_of[c + 1]}; }
};

static View* linear_views(const Program& program, int parameters, Room& room) {
    return views(room, program.loops * (1 + program.quantities + parameters));
}

static Linear linear(const Program& program, const double* workspace, const int32_t* columns, int n, View* to) {
    const int m = program.loops, k = program.quantities, before = m * (1 + k);
    for (int i = 0; i < before; i++) to[i] = {workspace + program.outputs[i]};
    for (int p = 0; p < n; p++)
        for (int i = 0; i < m; i++)
            to[before + p * m + i] = {workspace + program.outputs[before + (columns ? columns[p] : p) * m + i]};
    return {to, to + m, to + before, &program, columns, n};
}
