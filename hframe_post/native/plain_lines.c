/* Lines of a file as slicers write them, up to the first that needs a closer look: plain moves, lines
 * that pass in mid-motion, limits of motion and new names of E. It does what gcode/reader.py does, in
 * the same order. */

#include <string.h>

#include "kernels.h"

enum { EXACT_DIGITS = 15, LONGEST_LINE = 512, ROW = 8, MARK = 4, TAKEN = 6, CELL = 128, CELLS = 1024 };
enum { FEW_SETTINGS = 32 };           /* lines back in which a setting may be repeated */
enum { APPLY, SKIP };                 /* what to do with a line that limits the motion */
enum { NO_MOVE, TRAVELS, STANDS };    /* a move: x or y changes; only z or e does */

/* Powers of ten that a double holds exactly: a number of 15 digits over one of them is rounded once,
 * as strtod does. */
static const double TEN_TO[] = {1e0, 1e1, 1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15};

/* Read a number of digits with at most one point; return its end, or NULL if it is anything else. */
static const char *number(const char *c, double *value)
{
    int negative = *c == '-', digits = 0, decimals = -1;
    int64_t mantissa = 0;
    for (c += negative; (*c >= '0' && *c <= '9') || (*c == '.' && decimals < 0); c++) {
        if (*c == '.') {
            decimals = 0;
            continue;
        }
        mantissa = 10 * mantissa + (*c - '0');
        if (decimals >= 0)
            decimals++;
        if (++digits > EXACT_DIGITS)
            return NULL;
    }
    *value = (double)mantissa / TEN_TO[decimals > 0 ? decimals : 0];
    if (negative)
        *value = -*value;
    return digits ? c : NULL;
}

/* Return the end of the line after spaces and a comment, or NULL if anything else comes first. */
static const char *line_end(const char *c, const char *last)
{
    while (*c == ' ' || *c == '\t')
        c++;
    if (*c == ';')
        while (c < last && *c != '\n' && *c != '\r')
            c++;
    c += *c == '\r';
    return *c == '\n' && c < last ? c + 1 : NULL;
}

/* Read the words of a line in the order F X Y Z E F; return its end, or NULL if it is not a plain
 * move. given: a bit for each of x, y, z, e and F. */
static const char *words(const char *c, const char *last, double *value, int *given)
{
    static const char letters[] = "FXYZEF";
    static const int bit[] = {4, 0, 1, 2, 3, 4};
    *given = 0;
    if (c[0] != 'G' || (c[1] != '0' && c[1] != '1'))
        return NULL;
    c += 2;
    for (int k = 0; k < 6; k++) {
        if (c[0] != ' ' || c[1] != letters[k])
            continue;
        if (*given & 1 << bit[k] || (c = number(c + 2, value + bit[k])) == NULL)
            return NULL;
        *given |= 1 << bit[k];
    }
    return line_end(c, last);
}

/* ------------------------------------------------------------------------ lines that pass */

enum { PLAIN, CLOCK, PLACES, SETS, RESETS, OTHERS }; /* kinds, as in stream/marks.py */
enum { UNKNOWN, HARMLESS, TELLS, SHOWS, MODES, CHANGES, LABELS }; /* classes of names, as in plain_lines.py */

/* Words in lower case between bars, and which characters begin one. */
struct words {
    const char *list;
    uint8_t begins[256];
};

static int lower(char c) { return c >= 'A' && c <= 'Z' ? c + ('a' - 'A') : c; }

static struct words words_of(const char *list)
{
    struct words words = {list, {0}};
    for (const char *w = list; *w != 0; w++)
        if (*w != '|' && (w == list || w[-1] == '|'))
            words.begins[(uint8_t)*w] = 1;
    return words;
}

/* Return whether one of the words is here, in either case. */
static int is_any(const char *c, const struct words *words)
{
    if (!words->begins[lower(*c) & 255])
        return 0;
    for (const char *w = words->list; *w != 0; w += *w == '|') {
        for (const char *at = c; *w != '|' && *w != 0 && lower(*at) == *w; at++)
            w++;
        if (*w == '|' || *w == 0)
            return 1;
        while (*w != '|' && *w != 0)
            w++;
    }
    return 0;
}

enum { READER, LATER, TIMES, LISTS }; /* lists of words, see plain_lines.py */

/* Return the line feed that ends a line; NULL: it has a character that no line of text has.
 * has: set where the line has one of the words of a list; lists: NULL: it does not matter. */
static const char *rest(const char *c, const char *last, const struct words *lists, int has[LISTS])
{
    for (; *c != '\n'; c++) {
        if (*c == 0 || c >= last || (*c == '\r' && c[1] != '\n'))
            return NULL;
        for (int k = 0; lists && k < LISTS; k++)
            if (!has[k])
                has[k] = is_any(c, lists + k);
    }
    return c;
}

/* Set the number of a text (length); return whether it has one. known: a table of CELLS by hash, each
 * a text and its number. */
static int is_known(const char *text, int64_t length, const char *known, int64_t *number)
{
    uint32_t hash = 0;
    if (length >= CELL - (int64_t)sizeof *number)
        return 0;
    for (int64_t i = 0; i < length; i++)
        hash = hash * 31 + (uint8_t)text[i];
    for (uint32_t i = 0; i < CELLS; i++) {
        const char *cell = known + CELL * ((hash + i) % CELLS);
        if (*cell == 0)
            return 0;
        if (memcmp(cell, text, (size_t)length) == 0 && cell[length] == 0) {
            memcpy(number, cell + CELL - sizeof *number, sizeof *number);
            return 1;
        }
    }
    return 0;
}

/* Return the end of the words of M73, whole numbers; NULL: there is anything else. */
static const char *progress(const char *c, int64_t *kind)
{
    int seen = 0;
    while (*c == ' ') {
        char letter = *++c;
        if (*c == ' ' || *c == ';' || *c == '\n')
            continue;
        int clock = letter == 'S', digits = 0;
        if (letter < 'A' || letter > 'Z')
            return NULL;
        for (c++; *c >= '0' && *c <= '9'; c++)
            digits++;
        if (digits == 0 || digits > 9)
            return NULL;
        if (letter != 'R' && letter != 'S')
            continue;
        if (seen & 1 << clock)
            return NULL;
        seen |= 1 << clock;
        *kind = CLOCK;
    }
    return *c == ';' || *c == '\n' || (*c == '\r' && c[1] == '\n') ? c : NULL;
}

/* Return whether a comment says how much of the print has passed, as Cura does, and no more. */
static int elapsed(const char *c)
{
    static const char label[] = ";TIME_ELAPSED:";
    double seconds;
    if (strncmp(c, label, sizeof label - 1) != 0 || !(c[sizeof label - 1] >= '0')
        || (c = number(c + sizeof label - 1, &seconds)) == NULL || c[-1] == '.')
        return 0;
    return *c == '\n' || (*c == '\r' && c[1] == '\n');
}

/* known: names of commands and their classes, and lines with their line feeds and what the reader found
 * in them (see is_known); words. */
struct lists {
    const char *known;
    struct words words[LISTS];
};

struct state { /* mm and s; offset: of the place from what the file calls it */
    double at[COLUMNS], offset[COLUMNS], feed, speed, acceleration, travel_acceleration, corner,
        passed, object, left_object, setting, /* numbers; left_object: of the last motion */
        cruise_ratio, path_speed;
};

/* Return the line feed of a line that passes in mid-motion and that the reader need not know, or knows;
 * NULL: it is another one. */
static const char *passing(const char *c, const char *last, const struct lists *lists,
                           struct state *state, int64_t *kind)
{
    const char *line = c;
    int has[LISTS] = {0};
    int64_t class = HARMLESS, number = 0;
    *kind = PLAIN;
    while (*c == ' ' || *c == '\t')
        c++;
    if (*c == ';') {
        int tells = elapsed(c);
        c = rest(c, last, lists->words, has);
        *kind = tells ? CLOCK : has[TIMES] ? OTHERS : has[LATER] ? PLACES : PLAIN;
        class = has[READER] ? LABELS : HARMLESS;
    } else {
        const char *name = c;
        while ((*c >= 'A' && *c <= 'Z') || (*c >= '0' && *c <= '9') || *c == '_' || *c == '.')
            c++;
        int ended = *c == '\n' || (*c == '\r' && c[1] == '\n');
        if (!(ended || (c > name && (*c == ' ' || *c == ';'))))
            return NULL;
        if (c > name && (!is_known(name, c - name, lists->known, &class) || class == UNKNOWN))
            return NULL;
        if (class == TELLS && (c = progress(c, kind)) == NULL)
            return NULL;
        c = rest(c, last, class == SHOWS ? lists->words : NULL, has);
        if (class == MODES || has[TIMES])
            *kind = class == MODES ? RESETS : OTHERS;
    }
    if (c == NULL || class < CHANGES)
        return c;
    int known = is_known(line, c + 1 - line, lists->known, &number);
    if (class == LABELS) {
        state->object = known ? (double)number : state->object;
        return known ? c : NULL;
    }
    *kind = known && state->setting == (double)number ? PLAIN : SETS;
    state->setting = known ? (double)number : -1.0;
    return c;
}

/* Let a setting that the last of n lines repeats be one that nothing follows: no move is between them. */
static void supersede(const char *text, int64_t *marks, int64_t n)
{
    const int64_t *last = marks + MARK * (n - 1);
    for (int64_t *mark = marks + MARK * (n - 2); mark >= marks && mark[0] == last[0]; mark -= MARK) {
        if (last - mark > MARK * FEW_SETTINGS)
            return;
        if (mark[3] != SETS || mark[2] - mark[1] != last[2] - last[1])
            continue;
        if (memcmp(text + mark[1], text + last[1], (size_t)(last[2] - last[1])) == 0) {
            mark[3] = RESETS;
            return;
        }
    }
}

/* ------------------------------------------------------------------------ all lines */

struct rules { /* see plain_lines.py */
    double scale, factor, least_feed, farthest, most_filament, least[3], greatest[3], relative_e,
        most_per_path, least_path, longest, moves, m204, m205, velocity_limit, most_passed, per_line,
        several;
};
enum { STATE = sizeof(struct state) / sizeof(double), RULES = sizeof(struct rules) / sizeof(double) };

/* Read a plain move and change the state; return the end of its line, or NULL. */
static const char *move(const char *c, const char *last, const struct rules *rules,
                        struct state *state, int *moved)
{
    double value[COLUMNS + 1], to[COLUMNS], rate = state->feed, speed = state->speed;
    const double *at = state->at;
    int given, inside = 1;
    const char *next = words(c, last, value, &given);
    if (next == NULL)
        return NULL;
    if (given & 1 << 4) {
        rate = value[4] * rules->scale / 60.0;
        speed = rate * rules->factor;
        if (!(rate >= rules->least_feed))
            return NULL;
    }
    *moved = NO_MOVE;
    if (given & 15) {
        for (int k = X; k <= E; k++) {
            double from = k == E && rules->relative_e != 0.0 ? at[E] : state->offset[k];
            to[k] = given & 1 << k ? from + value[k] * rules->scale : at[k];
            inside &= to[k] > -rules->farthest && to[k] < rules->farthest;
        }
        for (int k = X; k <= Z; k++)
            inside &= rules->least[k] <= to[k] && to[k] <= rules->greatest[k];
        double dx = to[X] - at[X], dy = to[Y] - at[Y], dz = to[Z] - at[Z], de = fabs(to[E] - at[E]);
        double path = sqrt(dx * dx + dy * dy + dz * dz);
        *moved = dx != 0.0 || dy != 0.0 ? TRAVELS : STANDS;
        if (!inside || de > rules->most_filament || greater(path, de) > rules->longest * speed)
            return NULL;
        if (*moved == TRAVELS ? de > rules->most_per_path * path || path <= rules->least_path
                              : dz == 0.0 && de == 0.0)
            return NULL;
        if (*moved == TRAVELS) {
            if (state->left_object != 0.0 && state->object != state->left_object && rules->several != 0.0)
                return NULL;
            state->left_object = state->object;
        }
        for (int k = X; k <= E; k++)
            state->at[k] = to[k];
    }
    state->feed = rate, state->speed = speed;
    return next;
}

/* Return what follows a word in a line, or NULL. */
static const char *after(const char *c, const char *last, const char *word)
{
    size_t size = strlen(word);
    return last - c > (int64_t)size && memcmp(c, word, size) == 0 ? c + size : NULL;
}

/* Read the words of M204, or of M205 (corners); return the end of the line, or NULL. */
static const char *coded_limit(const char *c, const char *last, double rule, int corners,
                               struct state *state)
{
    double value, least = INFINITY, acceleration = 1.0;
    for (; *c == ' ' && c[1] != ' ' && c[1] != ';' && c[1] != '\n' && c[1] != '\r'; ) {
        char letter = c[1];
        int own = corners ? letter == 'X' || letter == 'Y' : letter == 'S';
        if (letter < 'A' || letter > 'Z' || letter == 'J' || !(own || corners || rule == SKIP))
            return NULL;
        if ((c = number(c + 2, &value)) == NULL || value < 0.0)
            return NULL;
        if (own)
            least = lesser(least, value), acceleration = value;
    }
    if ((c = line_end(c, last)) == NULL || !(acceleration >= (corners ? 0.0 : 1.0)))
        return NULL;
    if (rule == APPLY && least < INFINITY && corners)
        state->corner = least;
    else if (rule == APPLY && least < INFINITY)
        state->acceleration = state->travel_acceleration = acceleration;
    return c;
}

/* Read SET_VELOCITY_LIMIT; return its end, or NULL. */
static const char *velocity_limit(const char *c, const char *last, const struct rules *rules,
                                  struct state *state)
{
    static const char *const names[] = {"ACCEL=", "SQUARE_CORNER_VELOCITY=", "ACCEL_TO_DECEL=",
                                        "MINIMUM_CRUISE_RATIO=", "VELOCITY="};
    enum { ACCEL, CORNER, SLOWER, RATIO, VELOCITY, PARAMETERS };
    double value[PARAMETERS] = {state->acceleration, state->corner, 1.0, state->cruise_ratio,
                                state->path_speed};
    int given[PARAMETERS] = {0};
    while (*c == ' ' && c[1] != ';' && c[1] != '\n' && c[1] != '\r') {
        const char *next = NULL;
        int k = 0;
        while (*c == ' ')
            c++;
        while (k < PARAMETERS && (next = after(c, last, names[k])) == NULL)
            k++;
        if (next == NULL || given[k]++ || (c = number(next, &value[k])) == NULL)
            return NULL;
    }
    if ((c = line_end(c, last)) == NULL || !(value[ACCEL] >= 1.0 && value[SLOWER] >= 1.0)
        || !(value[CORNER] >= 0.0 && value[RATIO] >= 0.0 && value[VELOCITY] >= 0.1))
        return NULL;
    if (rules->velocity_limit == SKIP)
        return c;
    if (given[SLOWER])
        value[RATIO] = 1.0 - lesser(1.0, value[SLOWER] / value[ACCEL]);
    state->acceleration = state->travel_acceleration = value[ACCEL];
    state->corner = value[CORNER], state->cruise_ratio = value[RATIO], state->path_speed = value[VELOCITY];
    return c;
}

/* Read a line that limits the motion; return its end, or NULL. */
static const char *limit(const char *c, const char *last, const struct rules *rules,
                         struct state *state)
{
    const char *next;
    if ((next = after(c, last, "M204 ")) != NULL)
        return coded_limit(next - 1, last, rules->m204, 0, state);
    if ((next = after(c, last, "M205 ")) != NULL)
        return coded_limit(next - 1, last, rules->m205, 1, state);
    if ((next = after(c, last, "SET_VELOCITY_LIMIT ")) != NULL)
        return velocity_limit(next - 1, last, rules, state);
    return NULL;
}

/* Read a new name of E alone; return the end of its line, or NULL. */
static const char *renamed(const char *c, const char *last, const struct rules *rules,
                           struct state *state)
{
    double value;
    if (last - c < 7 || memcmp(c, "G92 E", 5) != 0 || (c = number(c + 5, &value)) == NULL
        || (c = line_end(c, last)) == NULL)
        return NULL;
    state->offset[E] = state->at[E] - value * rules->scale;
    return c;
}

/* Read the lines in a text (size) from ``offset`` on; it ends with a line feed and a 0.
 * rows (most, ROW): line, x, y, z, e, speed, acceleration, corner velocity of each move; this is
 * negative where x and y do not change. marks (most_marks, MARK): of each line that passes, the moves
 * before it, where it begins and ends, and its kind. taken: lines, bytes, marks, new names of E, lines
 * of kind SETS, and whether the next line needs a closer look. Returns the number of rows. */
static int64_t plain_lines(const char *text, int64_t size, int64_t offset, int64_t first_line,
                           int64_t most, int64_t most_marks, const char *known,
                           const char *for_reader, const char *for_later, const char *of_times,
                           struct state *state, const struct rules *rules, double *rows,
                           int64_t *marks, int64_t *taken)
{
    struct lists lists = {known, {words_of(for_reader), words_of(for_later), words_of(of_times)}};
    const char *c = text + offset, *last = text + size, *next, *end;
    int64_t count = 0, lines = 0, passed = 0;
    double ratio = state->cruise_ratio, path_speed = state->path_speed; /* hold for all moves */
    memset(taken, 0, TAKEN * sizeof *taken);
    for (; count < most && passed < most_marks && c < last; c = next, lines++) {
        double before = state->at[E];
        int64_t kind = PLAIN;
        int moved = NO_MOVE;
        int others = state->cruise_ratio != ratio || state->path_speed != path_speed;
        taken[5] = !others;
        if (memchr(c, '\n', (size_t)(last - c < LONGEST_LINE ? last - c : LONGEST_LINE)) == NULL)
            break;
        if (c[0] == 'G' && (c[1] == '0' || c[1] == '1')) {
            if (others || rules->moves == 0.0 || (next = move(c, last, rules, state, &moved)) == NULL)
                break;
        } else if ((next = limit(c, last, rules, state)) == NULL) {
            if (c[0] == 'G' && (next = renamed(c, last, rules, state)) != NULL)
                end = next - 1, taken[3] = 1;
            else if ((end = passing(c, last, &lists, state, &kind)) == NULL)
                break;
            double all = state->passed + (double)(end - c) + rules->per_line;
            if (all > rules->most_passed)
                break;
            state->passed = all;
            taken[4] += kind == SETS;
            int64_t *mark = marks + MARK * passed++;
            mark[0] = count, mark[1] = c - text, mark[2] = end - text, mark[3] = kind;
            if (kind == SETS)
                supersede(text, marks, passed);
            next = end + 1;
        }
        taken[5] = 0;
        if (moved == NO_MOVE)
            continue;
        double *row = rows + ROW * count++, *at = state->at;
        row[0] = (double)(first_line + lines);
        for (int k = X; k <= E; k++)
            row[1 + k] = at[k];
        row[5] = state->speed, row[7] = moved == STANDS ? -1.0 : state->corner;
        row[6] = at[E] != before ? state->acceleration : state->travel_acceleration;
        state->passed = 0.0;
    }
    taken[0] = lines, taken[1] = c - text - offset, taken[2] = passed;
    return count;
}

LOOP(plain_lines, TEXT(0), WITHIN(1, 0, ITEMS(0)), WITHIN(2, 0, WHOLE(1)), WHOLE(3), COUNT(4), COUNT(5),
     (const char *)BYTES(6, CELL * CELLS), TEXT(7), TEXT(8), TEXT(9), (struct state *)OUT_FLOATS(10, STATE),
     (const struct rules *)FLOATS(11, RULES), OUT_FLOATS(12, ROW * COUNT(4)),
     OUT_INTEGERS(13, MARK * COUNT(5)), OUT_INTEGERS(14, TAKEN))
