// Groups of elements that are found to belong together one pair at a time.
#pragma once

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <vector>

namespace scoup {

// Elements are numbered from 0; the lowest of a group stands for it.
template <class Number>
class Unions {
  public:
    explicit Unions(Number count) : parents_(size_t(count)) { std::iota(parents_.begin(), parents_.end(), Number(0)); }

    Number add() {
        parents_.push_back(Number(parents_.size()));
        return parents_.back();
    }
    size_t size() const { return parents_.size(); }

    // Returns the lowest element of the group of both.
    Number join(Number one, Number other) {
        one = first_of(one), other = first_of(other);
        return parents_[size_t(std::max(one, other))] = std::min(one, other);
    }

    // Writes the group of each element, numbered from 0 in the order of their lowest elements; returns how many there are.
    Number number(Number* groups) {
        Number count = 0;
        for (size_t i = 0; i < parents_.size(); ++i) {
            const Number first = first_of(Number(i));
            groups[i] = size_t(first) == i ? count++ : groups[first];
        }
        return count;
    }

  private:
    Number first_of(Number element) {
        auto& parents = parents_;
        while (parents[size_t(element)] != element)
            element = parents[size_t(element)] = parents[size_t(parents[size_t(element)])];
        return element;
    }

    std::vector<Number> parents_;
};

}  // namespace scoup
