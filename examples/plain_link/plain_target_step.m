function [t, head, reals] = plain_target_step(t, arrived, head_in, reals_in, is_instant, now_s, tick_s, own)
% One tick of a target of the plain link that has the clock: the rules of docs/reference/plain_link.md.
%
% t           state, from plain_target_start
% arrived     true if a frame of 40 bytes came in this tick
% head_in     its six whole numbers (magic, session, number, echo, order, faults), reals_in its two reals (time, command)
% is_instant  true in the ticks at which samples are taken and the frame is sent
% now_s       time of the tick, tick_s the interval of ticks, in s
% own         range_v, fastest_v_s (the output moves no faster), rest_v_s (on the way to rest), watchdog_s, and
%             coasts, the instants in 0.05 s, over which the output comes to a stand while no command comes
% head, reals six whole numbers and two reals of the frame to send, valid at an instant; put t.output_v out after that
magic = 827543634;
of_runner = 826495058;
if arrived
    f = double(head_in(:));
    order = f(5);
    if f(1) == of_runner && order <= 3
        t = counted(t, f(2), f(3), order, double(reals_in(2)), now_s, own);
    end
end
if t.state == 1 && now_s - t.fed_s > own.watchdog_s
    t.state = 2;
    t.faults = with_bit(t.faults, 1);
end
head = uint32([magic; t.session; t.instant; t.acting; t.state; t.faults]);
reals = [now_s; t.output_v];
if is_instant
    t.instant = t.instant + 1;
    if t.state == 1 && t.waiting > 0
        t.step_v = (t.waiting_v - t.acting_v) / (t.waiting - t.acting);
        t.acting = t.waiting;
        t.acting_v = t.waiting_v;
        t.waiting = 0;
        t.late = 0;
    else
        t.late = min(t.late + 1, own.coasts);
    end
end
if t.state == 1                        % towards the command, within the output's own limit
    aim_v = within(t.acting_v + t.step_v * (t.late - t.late ^ 2 / (2 * own.coasts)), own.range_v);
    t.output_v = t.output_v + within(aim_v - t.output_v, own.fastest_v_s * tick_s);
end
if t.state == 2
    t.output_v = t.output_v - within(t.output_v, own.rest_v_s * tick_s);
    if t.output_v == 0
        t.state = 3;
    end
end
end

function t = counted(t, session, number, order, command_v, now_s, own)
% Let a well-formed frame count.
if order == 1 && t.state == 3 && session == t.session + 1 && number == 0
    t.session = session;
    t.state = 1;
    t.faults = t.faults - has_bit(t.faults, 1) - 8 * has_bit(t.faults, 8) - 64 * has_bit(t.faults, 64);
    t.last = 0;
    t.acting = 0;
    t.acting_v = 0;
    t.step_v = 0;
    t.late = 0;
    t.waiting = 0;
    t.instant = 0;
    t.output_v = 0;
    t.fed_s = now_s;
end
if (order ~= 2 && order ~= 3) || session ~= t.session || number <= t.last
    return
end
t.last = number;
if t.state ~= 1
    return
end
if order == 3
    t.state = 2;
elseif ~(abs(command_v) <= own.range_v)    % also what is not a number
    t.state = 2;
    t.faults = with_bit(t.faults, 8);
else
    t.waiting = number;
    t.waiting_v = command_v;
    t.fed_s = now_s;
end
end

function y = within(value, limit)
y = min(max(value, -limit), limit);
end

function y = has_bit(faults, bit)
y = mod(floor(faults / bit), 2);
end

function faults = with_bit(faults, bit)
faults = faults + bit * (1 - has_bit(faults, bit));
end
