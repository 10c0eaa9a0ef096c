// What depends on parameters alone, one number at a time; outside its domain an operation gives
// NaN, as it does in the NumPy engine.

#pragma once

#include <cmath>
#include <limits>

#include "program.hpp"

namespace loopcal {

inline double signed_one(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a; }

inline double finite_or_nan(double value, bool inputs_finite) {
    return inputs_finite && std::isinf(value) ? std::numeric_limits<double>::quiet_NaN() : value;
}

inline double evaluate_number(int code, double a, double b) {
    switch (code) {
        case ADD: return a + b;
        case SUB: return a - b;
        case MUL: return a * b;
        case DIV: return b == 0.0 ? std::numeric_limits<double>::quiet_NaN() : a / b;
        case NEG: return -a;
        case POW: return finite_or_nan(std::pow(a, b), std::isfinite(a) && std::isfinite(b));
        case SQUARE: return a * a;
        case SQRT: return std::sqrt(a);
        case SIN: return std::sin(a);
        case COS: return std::cos(a);
        case TAN: return std::tan(a);
        case ARCSIN: return std::asin(a);
        case ARCCOS: return std::acos(a);
        case ARCTAN: return std::atan(a);
        case ARCTAN2: return std::atan2(a, b);
        case HYPOT: return std::hypot(a, b);
        case EXP: return finite_or_nan(std::exp(a), std::isfinite(a));
        case LOG: return finite_or_nan(std::log(a), std::isfinite(a));
        case ABS: return std::fabs(a);
        case SIGN: return signed_one(a);
    }
    return std::numeric_limits<double>::quiet_NaN();
}

}  // namespace loopcal
