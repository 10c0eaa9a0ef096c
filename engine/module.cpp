// The engine as Python sees it: tapes made ready to run, and blocks of poses run through them.

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "pool.hpp"
#include "program.hpp"
#include "scalar.hpp"

namespace nb = nanobind;
using namespace loopcal;

namespace {

using Numbers = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Table = nb::ndarray<const int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::ndim<2>, nb::device::cpu>;
using Out = nb::ndarray<double, nb::ndim<2>, nb::device::cpu>;
using Out1 = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Out3 = nb::ndarray<double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Marks = nb::ndarray<uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Counts = nb::ndarray<int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Factors = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;

void require(bool holds, const char* what) {
    if (!holds) throw std::invalid_argument(what);
}

std::vector<const Width*> usable_widths() {
    std::vector<const Width*> found{&width_2};
#if defined(LOOPCAL_X86)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2")) found.push_back(&width_4);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq")) found.push_back(&width_8);
#endif
    return found;
}

const Width* width = usable_widths().back();
int threads = 1;

std::vector<std::string> widths() {
    std::vector<std::string> names;
    for (const Width* one : usable_widths()) names.push_back(one->name);
    return names;
}

// In the order of Code; lower case as on a tape.
std::vector<std::string> codes() {
    return {"add", "sub", "mul", "div", "neg", "pow", "square", "sqrt", "sincos", "tan", "arcsin", "arccos", "arctan",
            "arctan2", "hypot", "exp", "log", "abs", "sign", "plus", "minus", "turn", "sin", "cos"};
}

void use_width(const std::string& name) {
    for (const Width* one : usable_widths())
        if (one->name == name) {
            width = one;
            return;
        }
    throw std::invalid_argument("this processor has no " + name);
}

Rows rows_of(const Matrix& matrix, size_t count, size_t poses, const char* what) {
    require(matrix.shape(0) == count && matrix.shape(1) == poses, what);
    require(matrix.shape(1) <= 1 || matrix.stride(1) == 1, "poses must lie side by side in memory");
    return {matrix.data(), static_cast<ptrdiff_t>(matrix.stride(0))};
}

struct NoiseOfBlock {
    Matrix sd;
    std::vector<int32_t> unmeasured, measured;
    std::vector<std::vector<int32_t>> places;
    std::vector<Factors> factors;
    std::vector<int32_t> own, shared;

    // `to` refers into this object; poses: how many the block has
    Noise plain(size_t quantities, size_t poses, std::vector<Covariance>& to) const {
        require(sd.shape(0) == quantities && (sd.shape(1) == 1 || sd.shape(1) == poses), "sd has a wrong shape");
        require(measured.size() + unmeasured.size() == quantities, "every quantity is measured or not");
        for (auto* some : {&unmeasured, &measured, &own, &shared})
            for (int32_t q : *some) require(q >= 0 && static_cast<size_t>(q) < quantities, "there is no such quantity");
        require(places.size() == factors.size(), "a covariance needs its quantities");
        for (size_t i = 0; i < places.size(); i++) {
            const size_t size = places[i].size(), dimensions = factors[i].ndim();
            for (int32_t place : places[i])
                require(place >= 0 && static_cast<size_t>(place) < (own.empty() ? measured : shared).size(), "there is no such measured quantity");
            require(dimensions == 2 || dimensions == 3, "a factor has two or three dimensions");
            require(factors[i].shape(dimensions - 1) == size && factors[i].shape(dimensions - 2) == size, "a factor has a wrong shape");
            require(dimensions == 2 || factors[i].shape(0) == poses, "a factor has a wrong number of poses");
            to.push_back({places[i].data(), static_cast<int>(size), factors[i].data(),
                          dimensions == 2 ? 0 : static_cast<ptrdiff_t>(size * size)});
        }
        return {sd.data(), static_cast<ptrdiff_t>(sd.stride(0)), sd.shape(1) == 1 ? 0 : static_cast<ptrdiff_t>(sd.stride(1)),
                unmeasured.data(), static_cast<int>(unmeasured.size()), measured.data(), static_cast<int>(measured.size()),
                to.data(), static_cast<int>(to.size()), own.empty() ? nullptr : own.data(), shared.data(), static_cast<int>(shared.size())};
    }
};

// Poses of one job: it depends on their number only, so that sums do not depend on the threads.
int poses_of_job(size_t poses) {
    const size_t pieces = (poses + 32 * PIECE - 1) / (32 * PIECE);
    return static_cast<int>(std::min<size_t>(std::max<size_t>(pieces, 1), 8) * PIECE);
}

int jobs_of(size_t poses) {
    const size_t each = poses_of_job(poses);
    return static_cast<int>((poses + each - 1) / each);
}

// Whether a signal came that Python has raised an exception for; only its main thread hears of any.
bool interrupted() {
    const nb::gil_scoped_acquire lock;
    return PyErr_CheckSignals() != 0;
}

// Jobs of poses on all threads, other Python threads let run meanwhile.
template <class Context>
void share(void (*run)(Context&, int begin, int end, int number, double* workspace), Context& context, size_t poses,
           size_t room) {
    struct Given { void (*run)(Context&, int, int, int, double*); Context& context; int each, poses; };
    Given given{run, context, poses_of_job(poses), static_cast<int>(poses)};
    const auto job = [](void* to, int number, double* workspace) {
        const Given& g = *static_cast<Given*>(to);
        g.run(g.context, number * g.each, std::min((number + 1) * g.each, g.poses), number, workspace);
    };
    const int count = threads;  // of use_threads, which needs the lock
    {
        const nb::gil_scoped_release without_lock;
        run_jobs(job, &given, jobs_of(poses), count, room, interrupted);
    }
    if (PyErr_Occurred()) throw nb::python_error();
}

class Engine {
public:
    Engine(Table instructions, std::vector<int> ends, std::vector<int32_t> outputs, std::vector<int> shape,
           std::vector<int> inputs, int registers, Table once, Numbers constants, std::vector<int32_t> numbers,
           std::vector<int32_t> factors, std::vector<std::vector<int32_t>> members, std::vector<std::vector<int32_t>> factor_of)
        : used_(std::move(numbers)) {
        require(ends.size() == 4 && shape.size() == 3 && inputs.size() == 2, "four stages, three shapes, two inputs");
        require(instructions.shape(1) == 7 && once.shape(1) == 3 && constants.shape(0) == once.shape(0), "tables of a wrong shape");
        for (size_t i = 0; i < once.shape(0); i++) take_once(&once(i, 0), constants(i), static_cast<int>(i));
        for (int32_t number : used_) require(number >= 0 && static_cast<size_t>(number) < once_.size(), "there is no such number");
        numbers_.assign(used_.size(), 0.0);
        rows_ = inputs[0] + inputs[1] + registers;
        for (size_t i = 0; i < instructions.shape(0); i++) take(&instructions(i, 0));
        for (int32_t output : outputs) outputs_.push_back(operand(output));
        const int wanted = shape[0] * (1 + shape[1] + shape[2] + static_cast<int>(members.size()));
        require(static_cast<int>(outputs_.size()) == wanted, "there are not so many outputs");
        for (int i = 0; i < wanted; i++) {
            if (i >= shape[0] && i % shape[0] == 0) ends_of_.push_back(static_cast<int32_t>(loops_of_.size()));
            if (i >= shape[0] && !always_zero(outputs[i])) loops_of_.push_back(i % shape[0]);
        }
        ends_of_.push_back(static_cast<int32_t>(loops_of_.size()));
        int before = 0;
        for (int i = 0; i < 4; i++) {
            require(ends[i] >= before && ends[i] <= static_cast<int>(instructions_.size()), "stages out of order");
            program_.ends[i] = before = ends[i];
        }
        program_.instructions = instructions_.data();
        program_.outputs = outputs_.data();
        program_.loops_of = loops_of_.data(), program_.ends_of = ends_of_.data();
        program_.loops = shape[0], program_.quantities = shape[1], program_.parameters = shape[2];
        program_.inputs = inputs[0], program_.known = inputs[1];
        for (int32_t factor : factors) factors_.push_back(operand(factor));
        share_columns(members, factor_of);
        program_.numbers = numbers_.data();
        program_.count = static_cast<int>(numbers_.size());
        program_.first = program_.count * TILE;
        program_.room = (static_cast<size_t>(program_.count) + rows_) * TILE;
    }
    Engine(const Engine&) = delete;

    void at(Numbers parameters) {
        std::vector<double> values(once_.size());
        for (size_t i = 0; i < once_.size(); i++) {
            const Once& one = once_[i];
            if (one.code == CONSTANT) values[i] = one.value;
            else if (one.code == PARAMETER) {
                require(static_cast<size_t>(one.a) < parameters.shape(0), "there are not so many parameters");
                values[i] = parameters(one.a);
            } else values[i] = evaluate_number(one.code, values[one.a], values[one.b]);
        }
        for (size_t i = 0; i < used_.size(); i++) numbers_[i] = values[used_[i]];
    }

    void evaluate(Matrix x, std::optional<Matrix> known, int stage, Out out) const {
        const size_t poses = x.shape(1);
        require(stage >= 0 && stage <= 2, "there is no such stage");
        const size_t count = program_.loops * (1 + program_.quantities + program_.parameters);
        require(out.shape(0) == count && out.shape(1) >= poses && (out.shape(1) <= 1 || out.stride(1) == 1), "no room for the outputs");
        const Evaluation job{&program_, rows_of(x, program_.inputs, poses, "x has a wrong shape"), known_rows(known, poses),
                             stage, out.data(), static_cast<ptrdiff_t>(out.stride(0))};
        struct Context { const Evaluation& job; const Width& width; } context{job, *width};
        share<Context>([](Context& c, int begin, int end, int, double* workspace) { c.width.evaluate(c.job, begin, end, workspace); },
                       context, poses, program_.room);
    }

    void reduce(Matrix readings, Matrix corrections, std::optional<Matrix> known, const NoiseOfBlock& noise, bool exact,
                bool by_parameter, bool rounding, Out correction, Out1 step, Marks singular, std::optional<Out3> rows,
                std::optional<Out> total) const {
        const size_t poses = readings.shape(1), k = program_.inputs;
        require(program_.quantities == program_.inputs, "derivatives by all quantities are needed");
        require(correction.shape(0) == k && correction.shape(1) == poses && (poses <= 1 || correction.stride(1) == 1) &&
                step.shape(0) == poses && singular.shape(0) == poses, "results have wrong shapes");
        std::vector<Covariance> blocks;
        const Noise plain = noise.plain(k, poses, blocks);
        require(plain.unmeasured_count <= program_.loops, "more unmeasured quantities than loops");
        require(noise.own.empty() || static_cast<int>(noise.own.size()) == program_.loops, "every loop has a reading of its own, or none has");
        const int r = program_.loops - plain.unmeasured_count, n = by_parameter ? program_.parameters : 0;
        require(!rows || (static_cast<int>(rows->shape(0)) == n + 1 && static_cast<int>(rows->shape(1)) == r && rows->shape(2) == poses), "rows have a wrong shape");
        require(!total || (total->shape(0) == total->shape(1) && static_cast<int>(total->shape(0)) == n + 1 && total->stride(1) == 1), "the total has a wrong shape");
        const Reduction job{&program_, &plain, rows_of(readings, k, poses, "readings have a wrong shape"),
                            rows_of(corrections, k, poses, "corrections have a wrong shape"), known_rows(known, poses), exact, by_parameter, rounding,
                            correction.data(), static_cast<ptrdiff_t>(correction.stride(0)), step.data(), singular.data(),
                            rows ? rows->data() : nullptr, static_cast<ptrdiff_t>(poses), width->room(program_, plain, n)};
        const size_t square = total ? static_cast<size_t>(n + 1) * (n + 1) : 0;
        const std::unique_ptr<double[]> parts(new double[square * jobs_of(poses)]);
        struct Context { const Reduction& job; const Width& width; double* parts; size_t square; } context{job, *width, parts.get(), square};
        share<Context>([](Context& c, int begin, int end, int number, double* workspace) {
            c.width.reduce(c.job, begin, end, workspace, c.square ? c.parts + number * c.square : nullptr);
        }, context, poses, job.room);
        if (total) add_up(parts.get(), jobs_of(poses), n + 1, *total);
    }

    void close(Matrix readings, Matrix corrections, std::optional<Matrix> known, const NoiseOfBlock& noise, bool exact, double tolerance,
               double contraction, Out correction, Out1 step, Out1 ratio, Counts rounds, Marks open) const {
        const size_t poses = readings.shape(1), k = program_.inputs;
        require(program_.quantities == program_.inputs, "derivatives by all quantities are needed");
        require(correction.shape(0) == k && correction.shape(1) == poses && (poses <= 1 || correction.stride(1) == 1) && step.shape(0) == poses &&
                ratio.shape(0) == poses && rounds.shape(0) == poses && open.shape(0) == poses, "results have wrong shapes");
        std::vector<Covariance> blocks;
        const Noise plain = noise.plain(k, poses, blocks);
        require(plain.unmeasured_count <= program_.loops, "more unmeasured quantities than loops");
        require(noise.own.empty() || static_cast<int>(noise.own.size()) == program_.loops, "every loop has a reading of its own, or none has");
        const Closing job{{&program_, &plain, rows_of(readings, k, poses, "readings have a wrong shape"),
                           rows_of(corrections, k, poses, "corrections have a wrong shape"), known_rows(known, poses), exact, false, false,
                           correction.data(), static_cast<ptrdiff_t>(correction.stride(0)), step.data(), nullptr, nullptr, 0,
                           width->room(program_, plain, 0)},
                          tolerance, contraction, ratio.data(), rounds.data(), open.data()};
        struct Context { const Closing& job; const Width& width; } context{job, *width};
        share<Context>([](Context& c, int begin, int end, int, double* workspace) { c.width.close(c.job, begin, end, workspace); },
                       context, poses, job.reduction.room);
    }

    void search(Matrix readings, Matrix corrections, std::optional<Matrix> known, const NoiseOfBlock& noise, Out change) const {
        const size_t poses = readings.shape(1), k = program_.inputs;
        require(program_.quantities == program_.inputs, "derivatives by all quantities are needed");
        std::vector<Covariance> blocks;
        const Noise plain = noise.plain(k, poses, blocks);
        require(plain.unmeasured_count <= program_.loops, "more unmeasured quantities than loops");
        require(noise.own.empty() || static_cast<int>(noise.own.size()) == program_.loops, "every loop has a reading of its own, or none has");
        require(static_cast<int>(change.shape(0)) == plain.unmeasured_count && change.shape(1) == poses && (poses <= 1 || change.stride(1) == 1), "the change has a wrong shape");
        const Search job{&program_, &plain, rows_of(readings, k, poses, "readings have a wrong shape"),
                         rows_of(corrections, k, poses, "corrections have a wrong shape"), known_rows(known, poses),
                         change.data(), static_cast<ptrdiff_t>(change.stride(0)), width->room(program_, plain, 0)};
        struct Context { const Search& job; const Width& width; } context{job, *width};
        share<Context>([](Context& c, int begin, int end, int, double* workspace) { c.width.search(c.job, begin, end, workspace); },
                       context, poses, job.room);
    }

private:
    static constexpr int CONSTANT = -1, PARAMETER = -2;
    struct Once { int code, a, b; double value; };

    // in the order of the poses, whichever thread was first
    static void add_up(const double* parts, int count, int size, Out& total) {
        const size_t square = static_cast<size_t>(size) * size;
        for (int i = 0; i < size; i++)
            for (int j = 0; j <= i; j++) {
                double sum = 0.0;
                for (int part = 0; part < count; part++) sum += parts[part * square + i * size + j];
                total.data()[i * total.stride(0) + j] = total.data()[j * total.stride(0) + i] = sum;
            }
    }

    Rows known_rows(const std::optional<Matrix>& known, size_t poses) const {
        if (program_.known == 0) return {nullptr, 0};
        require(known.has_value(), "known constants are missing");
        return rows_of(*known, program_.known, poses, "known constants have a wrong shape");
    }

    // Members of common columns, their factors, and where their sums stand.
    void share_columns(const std::vector<std::vector<int32_t>>& members, const std::vector<std::vector<int32_t>>& factor_of) {
        const int n = program_.parameters;
        require(members.size() == factor_of.size(), "members need a factor each");
        std::vector<bool> shared(n, false);
        ends_of_common_.push_back(0);
        for (size_t c = 0; c < members.size(); c++) {
            require(!members[c].empty() && members[c].size() == factor_of[c].size(), "members need a factor each");
            for (size_t i = 0; i < members[c].size(); i++) {
                const int32_t p = members[c][i], f = factor_of[c][i];
                require(p >= 0 && p < n && !shared[p], "a parameter is in one common column");
                require(f >= 0 && static_cast<size_t>(f) < factors_.size(), "there is no such factor");
                shared[p] = true;
                members_.push_back(p), factor_of_.push_back(f);
            }
            ends_of_common_.push_back(static_cast<int32_t>(members_.size()));
        }
        places_.resize(n + 1);
        for (int p = 0; p < n; p++)
            if (!shared[p]) places_[p] = static_cast<int32_t>(columns_.size()), columns_.push_back(p);
        const int alone = static_cast<int>(columns_.size()), commons = static_cast<int>(members.size());
        places_[n] = alone;
        int32_t width = (alone + 1 + 3) / 4 * 4;  // in blocks of their own, of at most four
        for (int c = 0; c < commons; c++) {
            for (int i = ends_of_common_[c]; i < ends_of_common_[c + 1]; i++)
                places_[members_[i]] = width + i - ends_of_common_[c];
            width += (ends_of_common_[c + 1] - ends_of_common_[c] + 3) / 4 * 4;
            columns_.push_back(n + c);
        }
        // sums of numbers take the room of sums in lanes
        if (!commons) width = 0;
        require(static_cast<size_t>(width) * width <= static_cast<size_t>(SUMS) * (n + 1) * (n + 1), "common columns have too few members");
        program_.multiples = {commons, static_cast<int>(factors_.size()), alone, factors_.data(), members_.data(),
                              factor_of_.data(), ends_of_common_.data(), columns_.data(), places_.data(), width};
    }

    // number >= 0: that row; -1 - i: number i
    int32_t operand(int32_t place) const {
        if (place < 0) {
            require(static_cast<size_t>(-1 - place) < used_.size(), "there is no such number");
            return (-1 - place) * TILE;
        }
        require(place < rows_, "there is no such row");
        return (static_cast<int32_t>(used_.size()) + place) * TILE;
    }

    bool always_zero(int32_t place) const {
        if (place >= 0) return false;
        const Once& one = once_[used_[-1 - place]];
        return one.code == CONSTANT && one.value == 0.0;
    }

    void take_once(const int32_t* row, double value, int position) {
        Once one{row[0], row[1], row[2], value};
        if (one.code == PARAMETER) require(one.a >= 0, "there is no such parameter");
        else if (one.code != CONSTANT)
            require(one.code >= 0 && one.code < CODES && one.a >= 0 && one.a < position && one.b >= 0 && one.b < position, "an operation refers ahead");
        once_.push_back(one);
    }

    void take(const int32_t* row) {
        require(row[0] >= 0 && row[0] < SIN, "there is no such operation");
        Instruction instruction{};
        instruction.code = row[0];
        for (int i = 0; i < 2; i++) {
            require(row[1 + i] >= 0, "results need a row");
            instruction.out[i] = operand(row[1 + i]);
        }
        for (int i = 0; i < 4; i++) instruction.in[i] = operand(row[3 + i]);
        instructions_.push_back(instruction);
    }

    std::vector<int32_t> used_;
    std::vector<double> numbers_;
    std::vector<Once> once_;
    std::vector<Instruction> instructions_;
    std::vector<int32_t> outputs_;
    std::vector<int32_t> loops_of_, ends_of_;
    std::vector<int32_t> factors_, members_, factor_of_, ends_of_common_, columns_, places_;
    int rows_ = 0;
    Program program_{};
};

}  // namespace

NB_MODULE(_compiled, m) {
    nb::set_leak_warnings(false);  // a process that ends leaves what it has to the system
    // Raised, here and in loopcal/expressions/choice.py, with every change of a signature or of what it means.
    m.attr("INTERFACE") = 3;
    m.doc() = "The compiled engine: tapes over blocks of poses, see loopcal.expressions.compiled.";
    m.def("codes", &codes, "Names of the operations; an operation's number is its place.");
    m.def("widths", &widths, "Names of the vector widths that this processor has, narrow to wide.");
    m.def("width", [] { return std::string(width->name); }, "Name of the vector width in use.");
    m.def("use_width", &use_width, nb::arg("name"), "Use another width of this processor's.");
    m.def("threads", [] { return threads; }, "How many threads share a block.");
    m.def("use_threads", [](int count) { require(count >= 1, "at least one thread"); threads = count; }, nb::arg("count"),
          "Let so many threads share a block.");
    nb::class_<NoiseOfBlock>(m, "Noise")
        .def(nb::init<Matrix, std::vector<int32_t>, std::vector<int32_t>, std::vector<std::vector<int32_t>>, std::vector<Factors>,
                      std::vector<int32_t>, std::vector<int32_t>>(),
             nb::arg("sd"), nb::arg("unmeasured"), nb::arg("measured"), nb::arg("places"), nb::arg("factors"), nb::arg("own"),
             nb::arg("shared"));
    nb::class_<Engine>(m, "Engine")
        .def(nb::init<Table, std::vector<int>, std::vector<int32_t>, std::vector<int>, std::vector<int>, int, Table, Numbers, std::vector<int32_t>,
                      std::vector<int32_t>, std::vector<std::vector<int32_t>>, std::vector<std::vector<int32_t>>>())
        .def("at", &Engine::at, nb::arg("parameters"))
        .def("evaluate", &Engine::evaluate, nb::arg("x"), nb::arg("known").none(), nb::arg("stage"), nb::arg("out"))
        .def("reduce", &Engine::reduce, nb::arg("readings"), nb::arg("corrections"), nb::arg("known").none(), nb::arg("noise"), nb::arg("exact"),
             nb::arg("by_parameter"), nb::arg("rounding"), nb::arg("correction"), nb::arg("step"), nb::arg("singular"), nb::arg("rows").none(), nb::arg("total").none())
        .def("close", &Engine::close, nb::arg("readings"), nb::arg("corrections"), nb::arg("known").none(), nb::arg("noise"), nb::arg("exact"),
             nb::arg("tolerance"), nb::arg("contraction"), nb::arg("correction"), nb::arg("step"), nb::arg("ratio"), nb::arg("rounds"), nb::arg("open"))
        .def("search", &Engine::search, nb::arg("readings"), nb::arg("corrections"), nb::arg("known").none(), nb::arg("noise"), nb::arg("change"));
}
