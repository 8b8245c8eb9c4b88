// Vectors for compilers without the vector extension of GCC and Clang (MSVC): the same operations, lane by lane.
// Part of simd.hpp, see there.
#pragma once

#include <cstddef>
#include <cstdint>

namespace monoloc {
namespace {

template <std::size_t bytes>
struct IntegerOf;
template <>
struct IntegerOf<4> {
  using type = std::int32_t;
};
template <>
struct IntegerOf<8> {
  using type = std::int64_t;
};

template <class T, std::size_t count>
struct alignas(count * sizeof(T)) Lanes {
  using Mask = Lanes<typename IntegerOf<sizeof(T)>::type, count>;  // all bits of a lane that is true

  T lane[count];

  Lanes() = default;
  Lanes(T value) {  // implicit, so that numbers may stand beside vectors
    for (T& each : lane) each = value;
  }
  T& operator[](std::size_t i) { return lane[i]; }
  const T& operator[](std::size_t i) const { return lane[i]; }

#define MONOLOC_LANES_BINARY(op)                                                              \
  friend Lanes operator op(Lanes a, const Lanes& b) {                                         \
    for (std::size_t i = 0; i < count; ++i) a.lane[i] = static_cast<T>(a.lane[i] op b.lane[i]); \
    return a;                                                                                 \
  }
  MONOLOC_LANES_BINARY(+)
  MONOLOC_LANES_BINARY(-)
  MONOLOC_LANES_BINARY(*)
  MONOLOC_LANES_BINARY(/)
  MONOLOC_LANES_BINARY(&)
  MONOLOC_LANES_BINARY(|)
  MONOLOC_LANES_BINARY(<<)
  MONOLOC_LANES_BINARY(>>)
#undef MONOLOC_LANES_BINARY

#define MONOLOC_LANES_COMPARISON(op)                                                           \
  friend Mask operator op(const Lanes& a, const Lanes& b) {                                    \
    Mask mask;                                                                                 \
    for (std::size_t i = 0; i < count; ++i) mask.lane[i] = a.lane[i] op b.lane[i] ? -1 : 0;    \
    return mask;                                                                               \
  }
  MONOLOC_LANES_COMPARISON(<)
  MONOLOC_LANES_COMPARISON(>)
  MONOLOC_LANES_COMPARISON(>=)
#undef MONOLOC_LANES_COMPARISON

  Lanes operator-() const {
    Lanes negative;
    for (std::size_t i = 0; i < count; ++i) negative.lane[i] = -lane[i];
    return negative;
  }
  Lanes& operator+=(const Lanes& other) { return *this = *this + other; }
  Lanes& operator|=(const Lanes& other) { return *this = *this | other; }
};

}  // namespace
}  // namespace monoloc
